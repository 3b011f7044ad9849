"""De-trending and de-noising by wavelets, paper C, eq. (1)-(3), over a whole record."""

from __future__ import annotations

import numpy as np
import pywt

from estimation.arrays import FloatArray


def filtered(values: FloatArray, level: int, wavelet: str, noisy_levels: int = 2) -> FloatArray:
    """What the details of levels `noisy_levels` + 1 to `level` hold of a record.

    The approximation of the last level is the trend, the first details are the noise; both are set to zero. The
    paper speaks of a hard threshold and prints none: it is read as removal.

    Args:
        values: (n,) or (n, axes), evenly sampled.
        level: depth of the transform; 8 in the paper's method, 7 in its experiment.
        wavelet: name in PyWavelets; a coiflet in the paper, of unknown order.
        noisy_levels: so many of the finest details go.

    Raises:
        ValueError: the record is too short for that level.
    """
    if pywt.dwt_max_level(len(values), pywt.Wavelet(wavelet).dec_len) < level:
        raise ValueError(f"{len(values)} samples are too few for level {level} of {wavelet}")
    parts = pywt.wavedec(values, wavelet, level=level, axis=0)  # [A_J, D_J, ..., D_1]
    for place in (0, *range(len(parts) - noisy_levels, len(parts))):
        parts[place] = np.zeros_like(parts[place])
    return np.asarray(pywt.waverec(parts, wavelet, axis=0)[: len(values)], dtype=np.float64)
