"""Principal components: the directions in which vectors vary most, each scaled to unit variance."""

import torch
from torch import Tensor


def principal_components(vectors: Tensor, count: int, floor: float = 0.0) -> tuple[Tensor, Tensor]:
    """Return the mean and first principal components of vectors, to project by ``(vectors - mean) @ axes``.

    Args:
        vectors: ``[N, D]``.
        count: how many to keep.
        floor: components whose deviation is below this fraction of the first one's are scaled as if they had that
            fraction, because scaling them up would amplify noise.

    Returns:
        Mean, float32 ``[D]``, and axes, ``[D, count]``; fewer columns if the vectors span fewer dimensions.
    """
    vectors = vectors.double()
    mean = vectors.mean(0)
    if len(vectors) < vectors.shape[1]:  # of 180 vectors of 2048 numbers a fiftieth of the time
        _, singular, rows = torch.linalg.svd(vectors - mean, full_matrices=False)
        values, axes = singular.square() / (len(vectors) - 1), rows.T
    else:
        values, axes = torch.linalg.eigh(torch.cov(vectors.T))
        values, axes = values.flip(0).clamp(min=0), axes.flip(1)
    kept = min(count, int((values > 1e-12 * values[0]).sum()))
    axes = axes[:, :kept]
    axes = axes * axes.gather(0, axes.abs().argmax(0, keepdim=True)).sign()  # which are left open
    deviations = values[:kept].sqrt()
    axes = axes / deviations.clamp(min=floor * deviations[0])
    return mean.float(), axes.float()
