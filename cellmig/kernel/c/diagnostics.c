/* What step control and tables ask for. */

/* Local bounds V J λmax(F⁻ᵀ K F⁻¹) of viscous and elastic stiffness, extremes of J, the largest speed² and |d|², of the
 * rate of deformation d = sym(Ḟ F⁻¹). */
void limits(const KernelData *s, double out[6])
{
    double viscous = 0, elastic = 0, low = INFINITY, high = -INFINITY, speed = 0, strain = 0;
    for (long b = 0; b < s->n_owned_blocks; b++) {
        const Block block = *block_at(s, b);
        v4 R[1][4];
        gather(s, &block, 1, s->state + D, R);
        for (int lane = 0; lane < block.lanes; lane++) {
            const long i = block.row + lane;
            const double *F = s->F + 16 * b + lane, *K = s->bound + 3 * i, *v = s->state + 2 * D * i + D;
            const double a = F[0], c = F[4], b_ = F[8], d = F[12], J = a * d - b_ * c;
            const double r = s->volume[4L * block.stencil + lane] / J;
            const double A = (d * d * K[0] - 2 * c * d * K[2] + c * c * K[1]) * r; /* F⁻ᵀ K F⁻¹ J² by entries */
            const double B = (b_ * b_ * K[0] - 2 * a * b_ * K[2] + a * a * K[1]) * r;
            const double C = (-b_ * d * K[0] + (a * d + b_ * c) * K[2] - a * c * K[1]) * r;
            const double top = 0.5 * (A + B) + sqrt(0.25 * (A - B) * (A - B) + C * C);
            if (!(top * s->viscous_weight[i] <= viscous)) viscous = top * s->viscous_weight[i];
            double weight = s->elastic_weight[i];
            if (DIRECTOR) { /* by its current gradient g, weight |g|²/J */
                const double *g = s->director_gradient + 4 * D * b + lane;
                const double g0 = d * g[0] - c * g[4], g1 = a * g[4] - b_ * g[0];
                weight += s->director_weight[i] * (g0 * g0 + g1 * g1) / (J * J * J);
            }
            if (!(top * weight <= elastic)) elastic = top * weight;
            if (!(J >= low)) low = J;
            if (!(J <= high)) high = J;
            const double v2 = v[0] * v[0] + v[1] * v[1];
            if (!(v2 <= speed)) speed = v2;
            const double d00 = R[0][0][lane] * d - R[0][2][lane] * c, d11 = R[0][3][lane] * a - R[0][1][lane] * b_;
            const double d01 = R[0][2][lane] * a - R[0][0][lane] * b_ + R[0][1][lane] * d - R[0][3][lane] * c;
            const double d2 = (d00 * d00 + d11 * d11 + 0.5 * d01 * d01) / (J * J);
            if (!(d2 <= strain)) strain = d2;
        }
    }
    out[0] = viscous; out[1] = elastic; out[2] = low; out[3] = high; out[4] = speed; out[5] = strain;
}

/* Energies of the elastic stabilisation, ½ modulus |C u|², by rows. */
void stiffness_energy(const KernelData *s, double *out)
{
    for (const Block *block = block_at(s, 0), *end = block + s->n_owned_blocks; block < end; block++) {
        v4 gradient[1][4], bend[1][D];
        gather_both(s, block, 1, 1, s->state, gradient, bend);
        const v4 modulus = load(s->bending_modulus + 4L * block->stencil);
        const v4 energy = 0.5 * modulus * (bend[0][0] * bend[0][0] + bend[0][1] * bend[0][1]);
        for (int i = 0; i < block->lanes; i++) out[block->row + i] = energy[i];
    }
}
