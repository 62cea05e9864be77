import pytest
import torch

from dirl.models import ComparingEncoder
from dirl.models.comparing import SCALE

POOLED, SHAPE = 5, (2, 3)


@pytest.fixture(params=[0, 5], ids=["read at once", "read by pair"])
def encoder(request):
    torch.manual_seed(0)
    sizes = {"width": 12, "comparison": 7, "projection": 4, "view_projection": 3, "pair_width": request.param}
    return ComparingEncoder(POOLED + 6, SHAPE, **sizes)


def views(count, seed=0):
    return torch.randn(count, 4, POOLED + 6, generator=torch.Generator().manual_seed(seed))


def test_the_goal_enters_by_the_cosines_of_its_patches_and_of_its_views_alone(encoder):
    seen, goals = views(6), (views(6, seed=1), views(6, seed=2))
    for projection in (encoder.patch_projection, encoder.view_projection):
        assert not torch.equal(*(encoder(seen, goal) for goal in goals))
        with torch.no_grad():
            projection.weight.zero_()
    assert torch.equal(*(encoder(seen, goal) for goal in goals))


def test_a_view_has_unit_vectors_and_one_that_is_not_known_no_cosine_with_anything(encoder):
    goal = views(6, seed=1)
    goal[:, 1:] = 0
    patches, of_views = (part.unflatten(1, (4, -1)) for part in encoder.embed_goal(goal).split(encoder.sizes, -1))
    assert patches[:, 1:].abs().max() == 0 == of_views[:, 1:].abs().max()
    torch.testing.assert_close(of_views[:, 0].norm(dim=-1), torch.ones(6))
    torch.testing.assert_close(patches[:, 0].unflatten(1, (SHAPE[0], -1)).norm(dim=-1), torch.ones(6, SHAPE[0]))


@pytest.mark.parametrize("encoder", [5], indirect=True)
def test_every_pair_of_views_is_read_by_the_same_layers(encoder):
    """Of an observed view and one of the goal the layers read what their patches have in common, wherever they are."""
    read = []
    encoder.pair_cosines.register_forward_hook(lambda _, rows, __: read.append(rows[0]))
    seen, goal = views(6), views(6, seed=1)
    encoder(seen, goal)
    encoder(seen.roll(1, 1), goal.roll(2, 1))
    first, turned = (rows.unflatten(1, (4, 4)) for rows in read)
    torch.testing.assert_close(turned, first.roll((1, 2), (1, 2)))
    patches = [
        torch.nn.functional.normalize(rows[3, view, POOLED:].view(2, 3) @ encoder.patch_projection.weight.T, dim=-1)
        for rows, view in ((seen, 1), (goal, 2))
    ]
    torch.testing.assert_close(first[3, 1, 2], SCALE * (patches[0] @ patches[1].T).flatten())
