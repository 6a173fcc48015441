"""Vectors and tensors in two or three dimensions, as nested tuples of numbers, arrays, dual numbers or symbols.

In two dimensions a body is in plane strain: the third direction has the stretch 1, F = diag(F, 1).
"""

from __future__ import annotations

SPACE = 3  # dimensions of space, of which a picture in the plane leaves one out


def dot(a, b):
    """Scalar product a·b of vectors."""
    return _total([x * y for x, y in zip(a, b, strict=True)])


def identity(n):
    """Unit tensor I of n dimensions."""
    return tuple(tuple(float(i == j) for j in range(n)) for i in range(n))


def transposed(A):
    """Transpose Aᵀ."""
    return tuple(zip(*A, strict=True))


def product(A, B):
    """Product A B."""
    return tuple(tuple(dot(row, column) for column in transposed(B)) for row in A)


def applied(A, b):
    """Product A b with a vector."""
    return tuple(dot(row, b) for row in A)


def outer(a, b):
    """Tensor product a ⊗ b."""
    return tuple(tuple(x * y for y in b) for x in a)


def contracted(A, B):
    """Double contraction A : B."""
    return dot([x for row in A for x in row], [x for row in B for x in row])


def combined(*terms):
    """Sum of multiples of tensors, given as pairs of a factor and a tensor."""
    n = range(len(terms[0][1]))
    return tuple(tuple(_total([k * A[i][j] for k, A in terms]) for j in n) for i in n)


def with_transpose(A):
    """Sum A + Aᵀ."""
    n = range(len(A))
    upper = {(i, j): A[i][j] + A[j][i] for i in n for j in n if i <= j}
    return tuple(tuple(upper[min(i, j), max(i, j)] for j in n) for i in n)


def cofactors(A):
    """Cofactors of A, which are det A A⁻ᵀ."""
    if len(A) == 2:
        (a, b), (c, d) = A
        return (d, -c), (-b, a)
    return cross(A[1], A[2]), cross(A[2], A[0]), cross(A[0], A[1])


def cross(a, b):
    """Vector product a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def determinant(A):
    """Determinant det A."""
    return dot(A[0], cofactors(A)[0])


def _total(values):
    """Sum of some numbers, without a zero to begin with."""
    first, *others = values
    return sum(others, first)
