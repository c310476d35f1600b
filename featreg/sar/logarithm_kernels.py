"""The natural logarithm inside compiled loops."""

from __future__ import annotations

import numpy as np

from featreg.runtime.jit import inlined


@inlined
def fast_log(value: np.float32) -> np.float32:
    """Natural logarithm of a positive normal float, to 4e-7: exponent from the bits, a polynomial for the rest.

    Written without branches and calls so that a loop around it becomes vector code.
    """
    # Numbers of 32 bits become 64 in every sum unless they are brought back: half as many at a time.
    bits = np.float32(value).view(np.int32)
    exponent = np.int32(np.int32(bits - np.int32(0x3F3504F3)) >> np.int32(23))
    m = np.int32(bits - np.int32(exponent << np.int32(23))).view(np.float32) - np.float32(1)
    p = np.float32(0.20491759) + m * (np.float32(-0.18680751) + m * np.float32(0.11931054))
    p = np.float32(0.33314675) + m * (np.float32(-0.24908289) + m * p)
    p = np.float32(1.00000095) + m * (np.float32(-0.50001144) + m * p)
    return np.float32(exponent) * np.float32(0.6931471805599453) + m * p
