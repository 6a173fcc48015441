/* What step control and tables ask for. */

/* What limits the step at one particle: J, and largest eigenvalue of V J F⁻ᵀ K F⁻¹, Σ |F⁻ᵀ g|²/J of reference
 * gradients g, |d|² of d = sym(Ḟ F⁻¹). */
typedef struct { double J, bound, gradient2, strain2; } Limits;

/* From K, the components 00, 11 … 01 … of a symmetric matrix times V; lanes of F and Ḟ, entries by columns; and g,
 * if there are any. */
static inline Limits limits_of(const double *F, const double *R, const double *K, double V, const double *g)
{
    double C[D][D], A[D][D], L[D][D], S[D][D], gradient2 = 0, strain2 = 0;
    const double J = cofactors_of(F, 4, C);
    for (int i = 0, k = D; i < D; i++) {
        S[i][i] = K[i];
        for (int j = i + 1; j < D; j++) S[i][j] = S[j][i] = K[k++];
    }
    for (int i = 0; i < D; i++) {
        for (int m = 0; m < M && g; m++) {
            double now = 0;
            for (int k = 0; k < D; k++) now += C[i][k] * g[4 * (D * m + k)];
            gradient2 += now * now;
        }
        for (int j = 0; j < D; j++) {
            A[i][j] = L[i][j] = 0;
            for (int k = 0; k < D; k++) {
                L[i][j] += R[4 * (i + D * k)] * C[j][k];
                for (int l = 0; l < D; l++) A[i][j] += C[i][k] * S[k][l] * C[j][l];
            }
            A[i][j] *= V / J;
        }
    }
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++) strain2 += 0.5 * L[i][j] * (L[i][j] + L[j][i]);
    return (Limits){J, largest_eigenvalue(A), gradient2 / (J * J * J), strain2 / (J * J)};
}

/* Local bounds of viscous and elastic stiffness, extremes of J, the largest speed² and |d|². */
void limits(const KernelData *s, double out[6])
{
    double viscous = 0, elastic = 0, low = INFINITY, high = -INFINITY, speed = 0, strain = 0;
    for (long b = 0; b < s->n_owned_blocks; b++) {
        const Block block = *block_at(s, b);
        v4 rates[1][D * D];
        double R[4 * D * D];
        gather(s, &block, 1, s->state + D, rates);
        for (int k = 0; k < D * D; k++) store(R + 4 * k, rates[0][k]);
        for (int lane = 0; lane < block.lanes; lane++) {
            const long i = block.row + lane;
            const double *g = DIRECTOR ? s->director_gradient + 4 * M * D * b + lane : 0;
            const Limits now = limits_of(s->F + 4 * D * D * b + lane, R + lane, s->bound + D * (D + 1) / 2 * i,
                                         s->volume[4L * block.stencil + lane], g);
            double weight = s->elastic_weight[i], v2 = 0;
            if (DIRECTOR) weight += s->director_weight[i] * now.gradient2;
            for (int c = 0; c < D; c++) v2 += velocity(s, i, c) * velocity(s, i, c);
            if (!(now.bound * s->viscous_weight[i] <= viscous)) viscous = now.bound * s->viscous_weight[i];
            if (!(now.bound * weight <= elastic)) elastic = now.bound * weight;
            if (!(now.J >= low)) low = now.J;
            if (!(now.J <= high)) high = now.J;
            if (!(v2 <= speed)) speed = v2;
            if (!(now.strain2 <= strain)) strain = now.strain2;
        }
    }
    out[0] = viscous; out[1] = elastic; out[2] = low; out[3] = high; out[4] = speed; out[5] = strain;
}

/* Energies of the elastic stabilisation, ½ modulus |C u|², by rows. */
void stiffness_energy(const KernelData *s, double *out)
{
    for (const Block *block = block_at(s, 0), *end = block + s->n_owned_blocks; block < end; block++) {
        v4 gradient[1][D * D], bend[1][D], square = {0};
        deformation_of_block(s, block - block_at(s, 0), gradient, bend);
        const v4 modulus = load(s->bending_modulus + 4L * block->stencil);
        for (int c = 0; c < D; c++) square += bend[0][c] * bend[0][c];
        const v4 energy = 0.5 * modulus * square;
        for (int i = 0; i < block->lanes; i++) out[block->row + i] = energy[i];
    }
}
