"""Several trainings as one program: what each run learns; the jobs of a sweep."""

from types import SimpleNamespace

import pytest
import torch
from commands import TINY, have_the_same_weights, room_file, rows_of, summary_of, train_config
from parts import make_parts, train_state
from pretend_graph import pretend
from refusals import refused
from train import imitate, imitation, learn, train

from dirl.cli.parsing import compose_training
from dirl.runs.folder import Run
from dirl.training import loops
from dirl.training.job import build_components
from dirl.training.stacked import Job, Stack, run_together, why_alone

VARIED = [
    ("seed=1",),
    ("seed=2", "imitation.fraction=0.4", "optimiser.lr=0.003", "reward.goal=5.0"),
    ("seed=3", "reinforcement.gamma=0.9", "reinforcement.entropy_coef=0.1", "imitation.bc_coef=1.0"),
]


OUTSIDE = (
    *("trust=[outside]", "encoder._target_=outside.Product", "heads._target_=outside.DeepHeads", "~heads.shared"),
    "+losses.confidence={_target_:outside.Confidence,weight:0.05}",
)
"""Encoder, heads and a loss that are not the package's."""


def make_runs(room, options=VARIED):
    """The parts of runs, with their states."""
    every = [make_parts(f"scene={room}", *TINY, *own) for own in options]
    for parts in every:
        parts.state = train_state(parts)
    return every


class Updates:
    """So many updates, of a stack or of one run."""

    def __init__(self, count, state):
        self.count, self.reports, self.state = count, [], state

    @property
    def goes_on(self):
        return len(self.reports) < self.count

    def record(self, report):
        self.reports.append(report.read())
        self.state.left.fill_(1 - len(self.reports) / 100)


def learned(stack, updates):
    loop = Updates(updates, stack)
    learn(stack, loop)
    return loop.reports


@pytest.mark.parametrize(("common", "scenes"), [((), 1), (OUTSIDE, 1), ((), 2)], ids=["own", "outside", "scenes"])
def test_each_run_of_a_stack_learns_what_it_learns_alone(common, scenes, tmp_path, monkeypatch):
    room = room_file(tmp_path)
    if scenes > 1:  # as on a GPU, where there are such stacks
        monkeypatch.setattr("dirl.models.policy.reading_waits", lambda tensor: True)
        (tmp_path / "other").mkdir()
        room = f"[{room},{room_file(tmp_path / 'other', name='other', seed=1)}]"
    options = [(*common, *own) for own in VARIED]
    stack = Stack(make_runs(room, options))
    reports = learned(stack, 3)
    for number, parts in enumerate(make_runs(room, options)):
        torch.manual_seed(parts.config.seed)
        for (alone,), together in zip(learned(parts.state, 3), reports, strict=True):
            own = together[number]
            assert (alone.goal_index, alone.steps, alone.frames) == (own.goal_index, own.steps, own.frames)
            assert own.values == pytest.approx(alone.values, abs=1e-4)
        weights = (dict(policy.named_parameters()) for policy in (stack.members[number].policy, parts.policy))
        torch.testing.assert_close(*weights, atol=1e-5, rtol=0)


def test_each_run_of_a_stack_imitates_as_it_does_alone(tmp_path):
    room = room_file(tmp_path)
    # The first ends by its loss, the second by its number of steps, while the third goes on.
    ends = ("imitation.loss_threshold=1.2", "imitation.max_steps=7", "imitation.max_steps=20")
    options = [
        ("imitation.max_steps=20", "imitation.lr=0.01", *own, end) for own, end in zip(VARIED, ends, strict=True)
    ]
    stack, every = Stack(make_runs(room, options)), make_runs(room, options)
    runs = [Run(tmp_path / f"stack{number}", parts.config) for number, parts in enumerate(every)]
    for run, parts in zip(runs, every, strict=True):
        run.begin(parts.world, parts.observation.order)
    imitate(runs, stack, [parts.demos for parts in every])
    for number, parts in enumerate(every):
        alone = Run(tmp_path / f"alone{number}", parts.config)
        alone.begin(parts.world, parts.observation.order)
        imitate([alone], parts.policy, [parts.demos])
        steps, own = rows_of(alone.folder / "imitation.csv"), rows_of(runs[number].folder / "imitation.csv")
        assert [(row["step"], row["accuracy"]) for row in own] == [(row["step"], row["accuracy"]) for row in steps]
        assert len(own) in (range(2, 7), (7,), range(8, 20))[number]
        weights = (dict(policy.named_parameters()) for policy in (stack.policies[number], parts.policy))
        torch.testing.assert_close(*weights, atol=1e-5, rtol=0)


def test_a_captured_update_computes_what_it_does_without_a_graph(tmp_path, monkeypatch, capsys):
    room = room_file(tmp_path)
    eager = Stack(make_runs(room))
    reports = learned(eager, 8)
    graphs = pretend(monkeypatch)
    captured = Stack(make_runs(room))
    assert learned(captured, 8) == reports
    assert [len(graph.calls) > 100 for graph in graphs] == [True]
    assert capsys.readouterr().err == ""
    assert (eager.weights == captured.weights).all()


SHORT = [*TINY, "imitation.max_steps=25", "reinforcement.frames_per_scene=240", "checkpoint.every_seconds=0"]


def jobs_in(folder, room, *options, changes=(("seed=1",), ("seed=2", "imitation.fraction=0.25"))):
    jobs = []
    for number, own in enumerate(changes):
        given = [f"scene={room}", *SHORT, "existing=keep", *options, *own]
        jobs.append(Job(compose_training(given), folder / str(number), given))
    return jobs


def test_every_job_of_a_stack_has_the_folder_it_would_have_alone_also_beside_one_that_diverges(tmp_path, capsys):
    room = room_file(tmp_path)
    changes = (("seed=1",), ("seed=2",), ("seed=3", "reinforcement.until=stable"), ("seed=4", "optimiser.lr=1e30"))
    jobs = jobs_in(tmp_path / "stack", room, changes=changes)
    *together, failed = run_together(jobs, train, imitation, learn)
    told = capsys.readouterr()
    assert f"3 runs as one: {tmp_path / 'stack/0'}, {tmp_path / 'stack/1'}, {tmp_path / 'stack/3'}" in told.out
    assert f"by itself: {tmp_path / 'stack/2'}: until=stable" in told.out
    assert "diverged" in str(failed)
    assert "diverged" in told.err
    assert (tmp_path / "stack/2/network.pt").is_file()
    (alone,) = run_together(jobs_in(tmp_path / "alone", room, changes=changes[1:2]), train, imitation, learn)
    folder, own = tmp_path / "stack" / "1", tmp_path / "alone" / "0"
    assert {file.name for file in folder.iterdir()} == {file.name for file in own.iterdir()}
    sizes = [(one / "network.pt").stat().st_size for one in (folder, own)]
    assert sizes[0] == pytest.approx(sizes[1], rel=0.05)
    assert (folder / "config.yaml").read_text() == (own / "config.yaml").read_text()
    assert summary_of(folder)["greedy"]["sr"] == together[1]["greedy"]["sr"]
    assert [one["frames"] for one in (*together, alone)] == [240] * 4
    steps = rows_of(folder / "imitation.csv")
    assert [row["step"] for row in steps] == [row["step"] for row in rows_of(own / "imitation.csv")]
    assert len(rows_of(folder / "evaluation.csv")) == 3


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of the jobs of a stack that nothing happened to."""
    folder = tmp_path_factory.mktemp("whole")
    ended = run_together(jobs_in(folder, room_file(folder)), train, imitation, learn)
    assert not [one for one in ended if isinstance(one, Exception)]
    return folder


@pytest.mark.parametrize("steps", [loops.ImitationSteps, loops.Updates])
def test_a_stack_that_was_killed_goes_on_to_the_same_bits(steps, whole, tmp_path, monkeypatch):
    room = whole / "room.h5"
    record, count = steps.record, []

    def killed(loop, reports):
        record(loop, reports)
        count.append(1)
        if len(count) == 4:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(steps, "record", killed)
        with pytest.raises(KeyboardInterrupt):
            run_together(jobs_in(tmp_path, room), train, imitation, learn)
    run_together(jobs_in(tmp_path, room), train, imitation, learn)
    for number in ("0", "1"):
        assert have_the_same_weights(whole / number, tmp_path / number)
        for name in ("imitation.csv", "evaluation.csv"):
            assert (whole / number / name).read_text() == (tmp_path / number / name).read_text()


def test_what_cannot_be_stacked_is_told(tmp_path):
    room = room_file(tmp_path)
    for option, reason in (
        ("memory=gru", "memory"),
        ("objective=none", "by reinforcement"),
        ("env.slip=0.1", "environ"),
    ):
        run = SimpleNamespace(config=train_config(f"scene={room}", *TINY, option), saved=None, folder="run")
        assert reason in why_alone(run.config, build_components(run))


def test_a_run_alone_is_captured_too(tmp_path, monkeypatch, capsys):
    graphs = pretend(monkeypatch)
    jobs = jobs_in(tmp_path, room_file(tmp_path), changes=(("seed=1",),))
    (alone,) = run_together(jobs, train, imitation, learn)
    assert alone["frames"] == 240
    assert len(graphs) == 2  # of imitation and reinforcement
    assert capsys.readouterr().err.count("CUDA graph") == 0


def test_without_a_card_a_sweep_is_refused_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    jobs = jobs_in(tmp_path, room_file(tmp_path), "device=cuda")
    refused("^device=cuda: torch sees no CUDA device here", run_together, jobs, train, imitation, learn)
