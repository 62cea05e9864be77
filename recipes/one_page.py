"""DIRL on one page: sections 3.2 to 3.5 of the paper in plain torch, for one room. Nothing of the package is imported.

    python recipes/one_page.py --seed 1 --frames 60000 --room path/to/dump.h5

The equations are numbered as in the paper; `docs/method.md` has them all. `recipes/train.py` is the same for several
rooms, with modules to swap, checkpoints and measures; its constants (`conf/preset/fast.yaml`) are those of this page.
"""

import argparse
from importlib.util import find_spec
from pathlib import Path

import h5py
import torch
import torch.nn.functional as F
from torch import Tensor, nn

ROOM = Path(str(getattr(find_spec("dirl"), "origin", ""))).parent / "scenes/data/bathroom_02.h5"  # one that is built in
AGENTS, STEPS, LIMIT = 64, 5, 200  # that walk together; between two updates; of an episode
GAMMA, LAMBDA, RATE = 0.95, 0.95, 1e-3
SHOWN, WIDTH, THRESHOLD = 0.05, 512, 0.9  # of all states, by the expert; of the layers; of the stop


class Room:
    """A dump as tables: a state is a place and a heading, and all that happens to an agent is a look-up."""

    def __init__(self, file: Path) -> None:
        with h5py.File(file) as dump:
            graph = torch.from_numpy(dump["graph"][:]).long()  # the next state by action: ahead, right, left, back
            features = torch.from_numpy(dump["resnet_feature"][:, 0]).float()  # of the view ahead, [N, 2048]
            self.goals = torch.from_numpy(dump.attrs["goals"][:]).long()
        states = torch.arange(len(graph))
        self.graph = torch.where(graph < 0, states[:, None], graph)  # a blocked move leads nowhere
        # 3.5, surrounding views: those ahead, right, back and left of the heading, by turning right again and again.
        right = self.graph[:, 1]
        surrounding = torch.stack([states, right, right[right], right[right[right]]], 1)
        deviation, mean = torch.std_mean(features, 0)
        standardised = (features - mean) / torch.where(deviation > 1e-6, deviation, 1.0)
        # N observations span at most N of 8192 dimensions: in coordinates of these, X V = U L, everything is the same.
        left, length, axes = torch.linalg.svd(standardised[surrounding].flatten(1).double(), full_matrices=False)
        kept = length > 3e-5 * length[0]
        self.observations, self.axes = (left * length)[:, kept].float(), axes[kept].T.float()
        # 3.4, template matching: the agent stops where its four views correlate with those of the goal.
        template = features[surrounding].flatten(1)
        template = F.normalize(template - template.mean(1, keepdim=True), dim=1)
        self.stop = template @ template[self.goals].T > THRESHOLD  # [N, goals]
        self.distance = torch.where(states[:, None] == self.goals, 0.0, torch.inf)  # in actions, [N, goals]
        for _ in states:
            self.distance = torch.minimum(self.distance, 1 + self.distance[self.graph].amin(1))
        self.distance[self.distance.isinf()] = -1  # the goal cannot be reached

    def starts(self, count: int) -> tuple[Tensor, Tensor]:
        """Draw goals, and states that reach them."""
        goal = torch.randint(len(self.goals), (count,))
        return torch.multinomial((self.distance[:, goal] > 0).T.float(), 1).squeeze(1), goal


class Policy(nn.Module):
    """Figure 2: Siamese layers embed observation and goal by the same weights; two heads on what they become."""

    def __init__(self, room: Room) -> None:
        super().__init__()
        self.room = room
        on_features = nn.Linear(len(room.axes), WIDTH)  # as which the first layer begins
        self.embedding = nn.Linear(room.axes.shape[1], WIDTH)
        self.embedding.load_state_dict({"weight": on_features.weight @ room.axes, "bias": on_features.bias})
        self.fusion, self.hidden = nn.Linear(2 * WIDTH, WIDTH), nn.Linear(WIDTH, WIDTH)
        self.actor, self.critic = nn.Linear(WIDTH, 4), nn.Linear(WIDTH, 1)

    def forward(self, state: Tensor, goal: Tensor) -> tuple[Tensor, Tensor]:
        """Give logits ``[B, 4]`` and values ``[B]``; many agents see the same, which is embedded once."""
        distinct, place = torch.unique(torch.cat([state, self.room.goals[goal]]), return_inverse=True)
        embedded = F.relu(self.embedding(self.room.observations[distinct]))[place]
        hidden = F.relu(self.hidden(F.relu(self.fusion(torch.cat(embedded.chunk(2), 1)))))
        return self.actor(hidden), self.critic(hidden).squeeze(1)


def imitate(policy: Policy) -> tuple[Tensor, Tensor, Tensor]:
    """3.3: an expert shows the first action of a shortest path, in a few states, for every goal; clone it."""
    room = policy.room
    shown = torch.randperm(len(room.graph))[: round(SHOWN * len(room.graph))]
    place, goal = torch.nonzero(room.distance[shown] > 0).T
    state = shown[place]
    nearer = room.distance[room.graph[state], goal[:, None]] == room.distance[state, goal][:, None] - 1
    action = torch.multinomial(nearer.float(), 1).squeeze(1)
    optimiser = torch.optim.Adam(policy.parameters(), lr=3e-4)
    for _ in range(300):
        loss = F.cross_entropy(policy(state, goal)[0], action)  # (12), of the softmax (11) of the logits
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if loss < 0.01:
            break
    return state, goal, action


@torch.no_grad()
def walk(policy: Policy, agents: list[Tensor]) -> tuple[dict[str, Tensor], list[Tensor]]:
    """3.2: let every agent take some steps; a new episode begins where one ends, at the goal or at the limit."""
    room, steps = policy.room, []
    for _ in range(STEPS):
        state, goal, age = agents
        action = torch.multinomial(policy(state, goal)[0].softmax(1), 1).squeeze(1)
        after = room.graph[state, action]
        arrived = after == room.goals[goal]
        reward = torch.where(arrived, 10.0, torch.where(after == state, -0.1, -0.01)) * 0.1  # 4.2, scaled
        over = arrived | (age + 1 >= LIMIT)
        step = {"state": state, "goal": goal, "action": action, "after": after}
        steps.append(step | {"reward": reward, "arrived": arrived, "over": over})
        begins = (*room.starts(AGENTS), torch.zeros_like(age))
        agents = [torch.where(over, new, old) for new, old in zip(begins, (after, goal, age + 1), strict=True)]
    return {key: torch.stack([step[key] for step in steps]) for key in steps[0]}, agents


def losses(policy: Policy, batch: dict[str, Tensor], shown: tuple[Tensor, ...], left: float) -> dict[str, Tensor]:
    """What is minimised while a fraction ``left`` of the training, 1 to 0, is still to come."""
    goal, shape = batch["goal"].flatten(), batch["reward"].shape
    with torch.no_grad():
        value, following = (policy(batch[key].flatten(), goal)[1].view(shape) for key in ("state", "after"))
    advantage = batch["reward"] + GAMMA * following * ~batch["arrived"] - value  # (4), less the value
    for step in reversed(range(STEPS - 1)):  # (6); with LAMBDA < 1 averaged over all numbers of steps
        advantage[step] += GAMMA * LAMBDA * advantage[step + 1] * ~batch["over"][step]
    logits, values = policy(torch.cat([batch["state"].flatten(), shown[0]]), torch.cat([goal, shown[1]]))
    log_chance = logits[: len(goal)].log_softmax(1)
    taken = log_chance.gather(1, batch["action"].flatten()[:, None]).squeeze(1)
    return {
        "objective": -(taken * advantage.flatten()).mean(),  # (7), its first sum
        "entropy": (0.01 + 0.01 * left) * (log_chance.exp() * log_chance).sum(1).mean(),  # (7), its second sum
        "critic": F.mse_loss(values[: len(goal)], (advantage + value).flatten()),  # (8), towards (5)
        "imitation": 0.3 * left * F.cross_entropy(logits[len(goal) :], shown[2]),  # (12), less and less of it
    }


@torch.no_grad()
def evaluate(policy: Policy) -> dict[str, float]:
    """4.3: walk from every start to every goal, greedily, until template matching (3.4) says that it is there."""
    room = policy.room
    state, goal = torch.nonzero(room.distance > 0).T
    shortest, steps, stopped = room.distance[state, goal], torch.zeros(len(state)), torch.zeros(len(state)).bool()
    for _ in range(LIMIT):
        state = torch.where(stopped, state, room.graph[state, policy(state, goal)[0].argmax(1)])
        steps += ~stopped
        stopped |= room.stop[state, goal]
    found = stopped & (state == room.goals[goal])  # a stop anywhere else is a failure
    spl = found * shortest / torch.maximum(steps, shortest)
    atl = torch.where(found, steps, LIMIT)  # what fails counts as the limit
    return {"sr": found.float().mean().item(), "spl": spl.mean().item(), "atl": atl.mean().item()}


def train(room: Path = ROOM, seed: int = 0, frames: int = 200_000) -> dict[str, float]:
    """Imitation, then reinforcement (algorithm 1); returns the measures of the trained policy."""
    torch.manual_seed(seed)
    policy = Policy(Room(room))
    shown = imitate(policy)
    optimiser = torch.optim.Adam(policy.parameters(), lr=RATE, eps=1e-5)
    agents = [*policy.room.starts(AGENTS), torch.zeros(AGENTS)]
    for done in range(0, frames, AGENTS * STEPS):  # 3.2: walk, and improve actor and critic
        left = 1 - done / frames
        optimiser.param_groups[0]["lr"] = RATE * left
        batch, agents = walk(policy, agents)
        loss = sum(losses(policy, batch, shown, left).values(), torch.zeros(()))
        optimiser.zero_grad()
        loss.backward()  # (9) and (10)
        nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
        optimiser.step()
    return evaluate(policy)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    for name, default in {"--room": ROOM, "--seed": 0, "--frames": 200_000}.items():
        parser.add_argument(name, type=type(default), default=default)
    for name, value in train(**vars(parser.parse_args())).items():
        print(f"{name.upper()} {value:.3f}")
