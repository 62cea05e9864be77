"""Patch features: cells in their order, and a projection that makes components comparable."""

import torch

from dirl.perception.backbones.patches import CELLS, cells_of
from dirl.perception.backbones.principal import principal_components


def test_cells_are_means_row_by_row():
    stage = torch.zeros(1, 1024, 6, 8)
    stage[0, 5, 0:3, 2:4] = 1.0  # the upper row's second cell
    stage[0, 5, 5, 7] = 6.0  # one pixel of six of the last cell
    cells = cells_of(stage)
    assert cells.shape == (1, CELLS[0] * CELLS[1], 1024)
    assert cells[0, :, 5].tolist() == [0, 1, 0, 0, 0, 0, 0, 1]
    assert cells[0, :, 4].abs().max() == 0


def test_a_projection_has_unit_variance_but_for_what_hardly_varies():
    generator = torch.Generator().manual_seed(0)
    scales = torch.tensor([4.0, 2.0, 1.0, 0.01])
    cells = torch.randn(20_000, 4, generator=generator) * scales + 7
    turned = cells @ torch.linalg.qr(torch.randn(4, 4, generator=generator))[0]
    mean, axes = principal_components(turned, 4, floor=0.05)
    projected = (turned - mean) @ axes
    deviations = projected.std(0)
    torch.testing.assert_close(deviations[:3], torch.ones(3), rtol=0.02, atol=0)
    assert deviations[3] < 0.06  # 0.01 / (0.05 * 4)
    assert principal_components(turned, 2, floor=0.05)[1].shape == (4, 2)


def test_components_of_few_vectors_are_those_of_the_same_vectors_several_times():
    few = torch.randn(6, 9, generator=torch.Generator().manual_seed(0))
    (mean, axes), (same, again) = (principal_components(vectors, 9) for vectors in (few, few.repeat(3, 1)))
    assert axes.shape == (9, 5)  # of six vectors about their mean
    torch.testing.assert_close(same, mean)
    torch.testing.assert_close(again, axes * (17 / 15) ** 0.5)  # variances are sums divided by N - 1
