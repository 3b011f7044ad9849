"""Change points gathered into bursts: k-means as in paper C, eq. (13), and a counterpart that needs no k."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimation.arrays import FloatArray

Indices = NDArray[np.int64]


def k_means(points: Indices, k: int) -> list[tuple[int, int]]:
    """First and last index of each cluster, in order: eq. (13), on the indices alone; k must be known beforehand.

    Raises:
        ValueError: there are fewer points than clusters.
    """
    if len(np.unique(points)) < k:
        raise ValueError(f"{len(points)} change points cannot form {k} clusters")
    from sklearn.cluster import KMeans

    label = KMeans(k, n_init=10, random_state=0).fit_predict(points[:, None].astype(np.float64))
    clusters = [points[label == number] for number in range(k)]
    return sorted((int(cluster.min()), int(cluster.max())) for cluster in clusters)


def by_gaps(points: Indices, t_s: FloatArray, gap_s: float = 1.0, least: int = 25) -> list[tuple[int, int]]:
    """The same as they come: a new cluster after a gap, one of few points is dropped."""
    if not len(points):
        return []
    borders = np.flatnonzero(np.diff(t_s[points]) > gap_s) + 1
    return [(int(part[0]), int(part[-1])) for part in np.split(points, borders) if len(part) >= least]
