"""Training of the learned recogniser, in rooms in which every state has several looks."""

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor
from tqdm import tqdm

from dirl.evaluation.episodes import bar_interval, drawn_looks
from dirl.perception.backbones.patches import are_fine, coarse
from dirl.perception.recognition import Learned
from dirl.perception.recognition.learned import COLUMNS
from dirl.perception.recognition.photo import PhotoOdds
from dirl.scenes import World
from dirl.scenes.graph import AHEAD, BACK, LEFT, RIGHT
from dirl.training.objectives import set_learning_rate

SAME, ANY = 0.4, 0.15
"""Shares of the pairs: of the same state, and of any two states of a room; the others are of neighbours."""

NEAR = (
    (AHEAD,), (BACK,), (AHEAD, AHEAD), (BACK, BACK),
    (RIGHT, AHEAD, LEFT), (LEFT, AHEAD, RIGHT), (RIGHT, AHEAD, LEFT),
    (RIGHT, AHEAD, LEFT, AHEAD), (LEFT, AHEAD, RIGHT, AHEAD), (RIGHT, AHEAD, LEFT, BACK), (LEFT, AHEAD, RIGHT, BACK),
    (RIGHT,), (LEFT,),
)  # fmt: skip
"""Actions to the states that are most like a state. A step aside looks most like an error of heading."""


def learn_recogniser(
    world: World,
    network: Learned,
    *,
    steps: int = 8000,
    batch_size: int = 256,
    lr: float = 1e-3,
    weight_decay: float = 0.05,
    seed: int = 0,
    watch: Callable[[int], None] | None = None,
) -> None:
    """Train a recogniser by cross-entropy on pairs of visits, with four views and with one as the reference.

    In rooms with fine patches `dirl.perception.recognition.photo.PhotoOdds` is trained on the same pairs. New log
    odds are too sure: call `calibrate` afterwards.

    Args:
        world: of rooms, with patches and at least two looks.
        network: without weights, or one to train on; that one goes on whitening by the rooms of its first training.
        steps: of AdamW; the learning rate falls linearly to zero.
        batch_size: pairs a step.
        lr: the first learning rate.
        weight_decay: of AdamW.
        seed: of weights and pairs.
        watch: called with the number of steps after each thousand.

    Raises:
        ValueError: the world has no patches, or one look.
    """
    if world.patches is None or world.looks < 2:
        raise ValueError("training a recogniser needs rooms with patches and looks: scenes sample patches=true looks=2")
    near, fine = torch.stack([_after(world.graph, actions) for actions in NEAR], 1), are_fine(world.patches)
    if not network.trained:
        network.measure(world.features[: len(world)], world.patches[: len(world)])
    elif fine and not network.photo.trained:
        network.photo.measure(world.patches[: len(world)])
    for calibration in (network.calibration, network.photo.calibration):
        calibration.copy_(torch.tensor([1.0, 0.0]))
    parts = zip(world.features.split(4096), world.patches.split(4096), strict=True)
    whitened = [network.whiten(*part) for part in parts]
    pooled, patches = (torch.cat(part) for part in zip(*whitened, strict=True))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        optimiser = torch.optim.AdamW(network.train().parameters(), lr, weight_decay=weight_decay)
        losses = torch.zeros(3 if fine else 2)
        for step in (bar := tqdm(range(steps), unit=" steps", mininterval=bar_interval())):
            set_learning_rate(optimiser, lr * min(1, (step + 1) / 200) * (1 - step / steps))
            seen, reference, same = _pairs(world, near, batch_size)
            compared = network.compare(*(network.project(pooled[ids], patches[ids]) for ids in (seen, reference)))
            odds = [network.of_columns(compared[:, :COLUMNS]), network.of_columns(compared)]
            if fine:
                odds.append(_by_fine_patches(network.photo, world.patches, seen, reference))
            every = torch.stack(odds)
            loss = F.binary_cross_entropy_with_logits(every, same.expand_as(every), reduction="none").mean(1)
            optimiser.zero_grad()
            loss.sum().backward()
            optimiser.step()
            losses = 0.99 * losses + 0.01 * loss.detach()
            if (step + 1) % 1000 == 0:
                names = ("photo", "four views", "photo by fine patches")[: len(losses)]
                shown = (f"{name} {value:.4f}" for name, value in zip(names, losses.tolist(), strict=True))
                bar.set_postfix_str(f"loss: {', '.join(shown)}")
                if watch is not None:
                    watch(step + 1)
                    network.train()
    network.eval()


def calibrate(network: Learned, world: World, pairs: int = 20_000, seed: int = 0) -> None:
    """Fit slope and intercept of the log odds, by logistic regression in rooms that the network was not trained in.

    The fraction of pairs of the same state is no evidence: its log odds are subtracted.

    Args:
        network: trained.
        world: of other rooms, with patches and looks.
        pairs: how many to draw, hard ones as in the training.
        seed: of the pairs.
    """
    assert world.patches is not None
    near = torch.stack([_after(world.graph, actions) for actions in NEAR], 1)
    fine = are_fine(world.patches) and network.photo.trained
    rows = [*network.calibration, *([network.photo.calibration] if fine else [])]
    for row in rows:
        row.copy_(torch.tensor([1.0, 0.0]))
    odds, truth = [], []
    with torch.random.fork_rng(devices=[]), torch.no_grad():
        torch.manual_seed(seed)
        for _ in range(pairs // 500):
            seen, reference, same = _pairs(world, near, 500)
            visits, goals = (network.describe(world.features[i], coarse(world.patches[i])) for i in (seen, reference))
            drawn = [_each(network, visits, part) for part in (goals[:, :1], goals)]
            if fine:
                drawn.append(_by_fine_patches(network.photo, world.patches, seen, reference))
            odds.append(torch.stack(drawn))
            truth.append(same)
    found, same = torch.cat(odds, 1), torch.cat(truth)
    fitted = torch.tensor([[1.0, 0.0]] * len(rows), requires_grad=True)
    optimiser = torch.optim.LBFGS([fitted], max_iter=100, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimiser.zero_grad()
        calibrated = fitted[:, :1] * found + fitted[:, 1:]
        value = F.binary_cross_entropy_with_logits(calibrated, same.expand_as(found))
        value.backward()
        return value

    optimiser.step(loss)
    for row, found_row in zip(rows, fitted.detach(), strict=True):
        row.copy_(found_row - torch.stack([torch.zeros(()), same.mean().logit()]))


def _each(network: Learned | PhotoOdds, seen: Tensor, reference: Tensor) -> Tensor:
    """Return the log odds of each of B visits with its own reference, described, float32 ``[B]``."""
    return network.scores(seen.unsqueeze(1), reference.unsqueeze(1)).flatten()


def _by_fine_patches(photo: PhotoOdds, patches: Tensor, seen: Tensor, reference: Tensor) -> Tensor:
    """The log odds of visits with the view ahead of references, view ids int64 ``[B, 4]`` each; float32 ``[B]``."""
    return _each(photo, *(photo.describe(patches[ids]) for ids in (seen, reference[:, 0])))


def _after(graph: Tensor, actions: tuple[int, ...]) -> Tensor:
    """Return where actions lead from each state, int64 ``[N]``."""
    state = torch.arange(len(graph))
    for action in actions:
        state = graph[state, action]
    return state


def _pairs(world: World, near: Tensor, size: int) -> tuple[Tensor, Tensor, Tensor]:
    """View ids of visits and references, int64 ``[B, 4]`` each, and whether they are of the same state, float."""
    states = len(world)
    first = torch.randint(states, (size,))
    scene = world.scene_of[first]
    sizes, offsets = torch.tensor([len(s) for s in world.scenes]), torch.tensor(world.offsets)
    anywhere = offsets[scene] + (torch.rand(size) * sizes[scene]).long()
    second = near[first, torch.randint(near.shape[1], (size,))]
    kind = torch.rand(size)
    second = torch.where(kind < SAME, first, torch.where(kind < SAME + ANY, anywhere, second))
    seen = drawn_looks(first, states, world)
    again = drawn_looks(second, states, world, besides=seen // states)
    visit, reference = (
        world.surrounding[picture % states] + (picture // states * states).unsqueeze(1) for picture in (seen, again)
    )
    return visit, reference, (first == second).float()
