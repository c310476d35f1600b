"""Linear least squares of many rows and few unknowns, a block of rows at a time."""

from __future__ import annotations

import numpy as np

from featreg.types import FloatArray

#: Most numbers of a block. OpenBLAS shares out products of larger ones over threads, which then wait for one another in
#: every column: fifty times the time of one thread has been seen.
BLOCK = 8000


def triangle(rows: FloatArray) -> FloatArray:
    """Return the triangular factor of a QR factorisation of (M, N) rows: min(M, N) rows, but for their signs.

    Blocks of rows are factorised one by one, and their triangles, one upon another, again, until one block is left: as
    stable as all rows at once [1]_, and the same bits on any number of threads.

    References
    ----------
    .. [1] J. Demmel, L. Grigori, M. Hoemmen, J. Langou, "Communication-optimal parallel and sequential QR and LU
       factorizations", SIAM J. Sci. Comput. 34(1), 2012, DOI 10.1137/080731992
    """
    wide = rows.shape[1]
    tall = max(BLOCK // wide, 2 * wide)
    while len(rows) > tall:
        blocks = -(-len(rows) // tall)
        filled = np.zeros((blocks * tall, wide))
        filled[: len(rows)] = rows
        rows = np.asarray(np.linalg.qr(filled.reshape(blocks, tall, wide), mode="r")).reshape(-1, wide)
    return np.asarray(np.linalg.qr(rows, mode="r"))


def least_squares(design: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what ``numpy.linalg.lstsq`` does, without the residuals and the rank, of what `triangle` leaves.

    Parameters
    ----------
    design : (M, N)
    values : (M,) or (M, K)

    Returns
    -------
    solution : (N,) or (N, K), the shortest where several are as good
    singular : (min(M, N),) singular values of the design, falling
    """
    count = design.shape[1]
    reduced = triangle(np.column_stack([design, values]))[:count]
    right = reduced[:, count:] if values.ndim == 2 else reduced[:, count]
    solution, _, _, singular = np.linalg.lstsq(
        reduced[:, :count], right, rcond=np.finfo(np.float64).eps * max(design.shape)
    )
    return np.asarray(solution, np.float64), np.asarray(singular, np.float64)
