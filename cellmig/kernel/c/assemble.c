/* The tangent of the stresses, block by block of D rows and columns: sum of G_a . A . G_b over the rows I that both
 * particles a and b belong to, A being the derivative of the stress of I by its deformation gradient, times its
 * volume.  The Laplacian and what is conjugate to it are a last column of both, where a scene has them. */

static inline __attribute__((always_inline)) void assemble_in(
    const int D, const int d, long n, const long *first, const long *entry, const long *row, const long *start,
    const long *column, const double *g, const double *A, long *where, const long *begin, const long *place, double *K)
{
    for (long a = 0; a < n; a++) {
        for (long p = begin[a]; p < begin[a + 1]; p++) where[place[p]] = p;
        for (long q = first[a]; q < first[a + 1]; q++) {
            const long e = entry[q];
            const double *law = A + (long)D * D * d * d * row[e];
            double T[36] = {0};  /* G_a . A, by i, k, l */
            for (int i = 0; i < D; i++)
                for (int j = 0; j < d; j++, law += D * d)
                    for (int kl = 0; kl < D * d; kl++) T[D * d * i + kl] += g[d * e + j] * law[kl];
            for (long f = start[row[e]]; f < start[row[e] + 1]; f++) {
                double *block = K + D * D * where[column[f]];
                const double *h = g + d * f;
                for (int ik = 0; ik < D * D; ik++)
                    for (int l = 0; l < d; l++) block[ik] += T[d * ik + l] * h[l];
            }
        }
    }
}

/* D dimensions;  d columns of P and F;  n particles;  first, entry: for each the entries of the gradients that are its
 * own;  row, start, column, g (D of the gradient, and the Laplacian): of the entries, and where rows begin;
 * A[(D d)² I]: dP_ij/dF_kl, row by row;  where: room for a number per column;  begin, place: of the blocks by
 * particles, and their columns;  K[D² p]: the blocks, zero at first. */
void assemble(long D, long d, long n, const long *first, const long *entry, const long *row, const long *start,
              const long *column, const double *g, const double *A, long *where, const long *begin, const long *place,
              double *K)
{
    if (D == 2 && d == 2) assemble_in(2, 2, n, first, entry, row, start, column, g, A, where, begin, place, K);
    if (D == 2 && d == 3) assemble_in(2, 3, n, first, entry, row, start, column, g, A, where, begin, place, K);
    if (D == 3 && d == 3) assemble_in(3, 3, n, first, entry, row, start, column, g, A, where, begin, place, K);
    if (D == 3 && d == 4) assemble_in(3, 4, n, first, entry, row, start, column, g, A, where, begin, place, K);
}
