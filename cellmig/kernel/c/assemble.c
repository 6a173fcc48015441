/* The tangent of the stresses, block by block of two rows and columns: sum of G_a . A . G_b over the rows I that both
 * particles a and b belong to, A being the derivative of the stress of I by its deformation gradient, times its
 * volume. */

/* n particles;  first, entry: for each the entries of the gradients that are its own;  row, start, column, g (x, y): of
 * the entries, and where rows begin;  A[16 I]: dP_ij/dF_kl, row by row;  where: room for a number per column;  begin,
 * place: of the blocks by particles, and their columns;  K[4 p]: the blocks, zero at first. */
void assemble(long n, const long *first, const long *entry, const long *row, const long *start, const long *column,
              const double *g, const double *A, long *where, const long *begin, const long *place, double *K)
{
    for (long a = 0; a < n; a++) {
        for (long p = begin[a]; p < begin[a + 1]; p++) where[place[p]] = p;
        for (long q = first[a]; q < first[a + 1]; q++) {
            const long e = entry[q];
            const double *law = A + 16 * row[e], x = g[2 * e], y = g[2 * e + 1];
            double T[8];  /* G_a . A, by i, k, l */
            for (int i = 0; i < 2; i++)
                for (int kl = 0; kl < 4; kl++) T[4 * i + kl] = x * law[8 * i + kl] + y * law[8 * i + 4 + kl];
            for (long f = start[row[e]]; f < start[row[e] + 1]; f++) {
                double *block = K + 4 * where[column[f]];
                const double *h = g + 2 * f;
                for (int ik = 0; ik < 4; ik++) block[ik] += T[2 * ik] * h[0] + T[2 * ik + 1] * h[1];
            }
        }
    }
}
