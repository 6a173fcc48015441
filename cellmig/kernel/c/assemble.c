/* The tangent of the stresses, block by block of two rows and columns: sum of G_a . A . G_b over the rows I that both
 * particles a and b belong to, A being the derivative of the stress of I by its deformation gradient, times its
 * volume.  The Laplacian and what is conjugate to it are a third column of both, where a scene has them. */

/* n particles;  first, entry: for each the entries of the gradients that are its own;  row, start, column, g (x, y, and
 * the Laplacian): of the entries, and where rows begin;  A[(2 d)² I]: dP_ij/dF_kl, row by row, with d columns of P and
 * F;  where: room for a number per column;  begin, place: of the blocks by particles, and their columns;  K[4 p]: the
 * blocks, zero at first. */
void assemble(long n, long d, const long *first, const long *entry, const long *row, const long *start,
              const long *column, const double *g, const double *A, long *where, const long *begin, const long *place,
              double *K)
{
    for (long a = 0; a < n; a++) {
        for (long p = begin[a]; p < begin[a + 1]; p++) where[place[p]] = p;
        for (long q = first[a]; q < first[a + 1]; q++) {
            const long e = entry[q];
            const double *law = A + 4 * d * d * row[e];
            double T[12] = {0};  /* G_a . A, by i, k, l */
            for (int i = 0; i < 2; i++)
                for (int j = 0; j < d; j++, law += 2 * d)
                    for (int kl = 0; kl < 2 * d; kl++) T[2 * d * i + kl] += g[d * e + j] * law[kl];
            for (long f = start[row[e]]; f < start[row[e] + 1]; f++) {
                double *block = K + 4 * where[column[f]];
                const double *h = g + d * f;
                for (int ik = 0; ik < 4; ik++)
                    for (int l = 0; l < d; l++) block[ik] += T[d * ik + l] * h[l];
            }
        }
    }
}
