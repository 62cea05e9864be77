"""Ranks: two processes that train one policy, as ``torchrun`` starts them."""

import os
import signal

import pytest
import torch
import train
from commands import SAVED, TINY, room_file, start_recipe, train_config, wait_until
from parts import make_parts, train_in
from torch.distributed import TCPStore

from dirl.config.schemas import ConfigError
from dirl.models import plain_weights
from dirl.runs import ranks
from dirl.runs.checkpoints import load_checkpoint
from dirl.runs.finding import RunError
from dirl.training.build import build_env
from dirl.training.pairs import DrawnPairs

RANKS = 2
SHORT = [*TINY, "imitation.max_steps=5", "imitation.loss_threshold=0", "imitation.sampled=true"]
SHORT += ["imitation.batch_size=32", "imitation.fraction=1", "imitation.bc_coef=0"]


class Ranks:
    """A recipe in two processes; as under ``torchrun`` the store is here, and the end of one ends the other."""

    def __init__(self, folder, *arguments):
        self.store = TCPStore("127.0.0.1", 0, is_master=True, wait_for_workers=False)
        self.ranks = []
        for rank in range(RANKS):
            told = {"RANK": rank, "LOCAL_RANK": rank, "WORLD_SIZE": RANKS, "LOCAL_WORLD_SIZE": RANKS}
            told |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": self.store.port}
            told |= {"TORCHELASTIC_USE_AGENT_STORE": True, "TORCHELASTIC_RESTART_COUNT": 0}
            with pytest.MonkeyPatch.context() as patch:
                for name, value in told.items():
                    patch.setenv(name, str(value))
                self.ranks.append(start_recipe(folder, "train", *arguments))

    def wait(self, first=0):
        """How each ended, waited for from this one on; the other is terminated if it failed."""
        ended = {first: self.ranks[first].wait()}
        if ended[first].status:
            os.kill(self.ranks[1 - first].pid, signal.SIGTERM)
        ended[1 - first] = self.ranks[1 - first].wait()
        return [ended[rank] for rank in range(RANKS)]


def run_ranks(folder, *arguments):
    ended = Ranks(folder, *arguments).wait()
    assert [one.status for one in ended] == [0, 0], ended
    return ended


def as_one_rank(monkeypatch, config):
    """Let one process draw and walk what two ranks with half of it each would."""
    seeds = [config.seed + ranks.SEEDS * rank for rank in range(RANKS)]
    random = [torch.Generator().manual_seed(seed).get_state() for seed in seeds]
    walking, draw, collect = [], DrawnPairs.draw, train.collect

    def in_turn(function):
        found = []
        for rank in range(RANKS):
            torch.set_rng_state(random[rank])
            found.append(function(rank))
            random[rank] = torch.get_rng_state()
        return found

    def draw_both(pairs, size):
        return torch.cat(in_turn(lambda _: draw(pairs, size // RANKS)))

    def collect_both(env, operator, agents, steps):
        if not walking:
            half = len(agents) // RANKS
            parts = (env.base_env.world, env.transform[1], operator)
            envs = [build_env(config, *parts, agents=half, seed=seed) for seed in seeds]
            walking.extend([one, one.reset()] for one in envs)

        def walk(rank):
            batch, walking[rank][1] = collect(walking[rank][0], operator, walking[rank][1], steps)
            return batch

        return torch.cat(in_turn(walk)), agents

    monkeypatch.setattr(DrawnPairs, "draw", draw_both)
    monkeypatch.setattr(train, "collect", collect_both)


def test_two_ranks_give_the_updates_of_one(tmp_path, monkeypatch):
    options = [f"scene={room_file(tmp_path)}", *SHORT, "evaluation.times=0"]
    options += ["reinforcement.frames_per_scene=300"]
    first, second = run_ranks(tmp_path, *options, "hydra.run.dir=two")
    assert "300 frames" in first.printed
    assert (second.printed, second.errors) == ("", "")
    found = load_checkpoint(tmp_path / "two")["network"]
    parts = make_parts(*options)
    before = {name: value.clone() for name, value in plain_weights(parts.policy).items()}
    as_one_rank(monkeypatch, parts.config)
    train_in(tmp_path / "one", parts)
    expected = plain_weights(parts.policy)
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5)
    for name in ("encoder.embedding.weight", "heads.value.scenes.grid.weight"):
        assert (expected[name] - before[name]).abs().max() > 1e-3
    tables = [(tmp_path / run / "imitation.csv").read_text().splitlines() for run in ("one", "two")]
    assert len(tables[0]) == len(tables[1]) == 1 + 5


def test_a_lost_rank_ends_the_run_which_goes_on_with_as_many(tmp_path):
    options = [f"scene={room_file(tmp_path)}", *SHORT, "reinforcement.frames_per_scene=900", "evaluation.times=0"]
    run_ranks(tmp_path, *options, "hydra.run.dir=whole")
    running = Ranks(tmp_path, *options, "hydra.run.dir=killed", SAVED)
    wait_until(lambda: list((tmp_path / "killed").glob("checkpoints/0*[1-9]*.pt")))
    running.ranks[1].send_signal(signal.SIGKILL)
    left, killed = running.wait()
    assert (left.status, killed.status) == (75, -signal.SIGKILL)
    (line,) = left.told
    assert line == (
        "error: another process of this run was lost; its last checkpoint is safe; resume with: torchrun "
        "--nproc-per-node=2 recipes/train.py resume=killed"
    )
    ended = start_recipe(tmp_path, "train", "resume=killed").wait()
    assert (ended.status, ended.told) == (1, ["error: killed: was trained by 2 ranks, not 1; resume it with as many"])
    run_ranks(tmp_path, "resume=killed")
    whole, resumed = (load_checkpoint(tmp_path / run)["network"] for run in ("whole", "killed"))
    assert all(torch.equal(value, resumed[name]) for name, value in whole.items())
    assert not (tmp_path / "killed" / "checkpoints").exists()


def test_what_cannot_be_shared_is_refused_by_one_of_the_ranks(tmp_path):
    ended = Ranks(tmp_path, f"scene={room_file(tmp_path)}", *SHORT, "reinforcement.workers=2").wait()
    told = [line for one in ended for line in one.told]
    assert len(told) == 1, told
    assert "error: torchrun with 2 ranks: reinforcement.workers=2: asynchronous workers" in told[0]
    assert [entry.name for entry in tmp_path.iterdir()] == ["room.h5"]


@pytest.mark.parametrize(
    ("options", "alone", "told"),
    [
        ([], False, "start the jobs of a sweep"),
        (["system=a3c"], True, "asynchronous workers"),
        (["system=dagger"], True, r"imitation\.rounds=5: DAgger"),
        (["preset=paper"], True, "ranks average their gradients"),
        (["reinforcement.agents_per_scene=7"], True, "7 agents cannot be shared equally by 2 ranks"),
    ],
)
def test_refusals_say_what_to_do(monkeypatch, options, alone, told):
    monkeypatch.setattr(ranks, "size", lambda: 2)
    config = train_config("scene=bathroom_02", *options)

    def ask():
        ranks.check(config, alone=alone)
        ranks.share_of_agents(config, scenes=1)

    with pytest.raises(ConfigError, match=told):
        ask()


def test_shares_add_up_and_seeds_differ(monkeypatch):
    monkeypatch.setattr(ranks, "size", lambda: 4)
    shares, seeds = [], set()
    for number in range(4):
        monkeypatch.setattr(ranks, "rank", lambda number=number: number)
        shares.append(ranks.share(10))
        seeds.add(ranks.own_seed(2**63 - 1))
        assert ranks.share_of_agents(train_config("scene=bathroom_02"), scenes=2) == 32
    assert (shares, len(seeds)) == ([3, 3, 2, 2], 4)
    assert all(0 <= seed < 2**63 for seed in seeds)


def test_a_checkpoint_is_of_a_number_of_ranks(monkeypatch):
    saved = {"frames": 5, "random": 0, "others": [{"random": 1}, {"random": 2}]}
    monkeypatch.setattr(ranks, "size", lambda: 3)
    monkeypatch.setattr(ranks, "rank", lambda: 2)
    assert ranks.own_part(saved, "run")["random"] == 2
    for other in ({"frames": 5}, {"others": [{}]}):
        with pytest.raises(RunError, match="resume it with as many"):
            ranks.own_part(other, "run")


def test_without_torchrun_there_is_one_rank():
    parameter = torch.nn.Parameter(torch.ones(2))
    parameter.grad = torch.tensor([1.0, 2.0])
    ranks.average_gradients([parameter], 5)
    assert parameter.grad.tolist() == [1, 2]
    assert (ranks.rank(), ranks.size(), ranks.share(7), ranks.own_seed(3)) == (0, 1, 7, 3)
    assert ranks.tell("a", [2], True) == (["a"], [2], True)
    assert ranks.from_first(lambda: 4) == 4
    assert ranks.with_others({"a": 1}, ("a",)) == {"a": 1}
