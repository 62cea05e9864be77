"""Train an agent to find its goals: imitation of a few demonstrations, then actor-critic.

    python recipes/train.py scene=bathroom_02
    python recipes/train.py scene=all seed=1 logger=wandb
    python recipes/train.py scene=kitchen_02 preset=paper system=td_drl
    python recipes/train.py -m scene=bathroom_02 imitation.fraction=0,0.05,0.5 seed=0,1,2
    python recipes/train.py -m experiment=fig8
    python recipes/train.py resume=runs/dirl_bathroom_02/2026-01-31_12-00-00

Values of all options: conf/train.yaml and the groups beside it; what they mean: --help. What a run needs besides its
training is in `dirl.training.job`; progress, checkpoints and interrupts are in `dirl.training.loops`.
"""

from dirl.cli.start import run, start

if __name__ == "__main__":
    start(__doc__)  # "loading ...", or help; the imports below take their time

from collections.abc import Callable, Sequence
from typing import Any

import hydra
import torch
from omegaconf import DictConfig
from torch import Tensor

from dirl.config.folders import CONF
from dirl.evaluation.protocol import EvaluationProtocol
from dirl.models import ActorCritic, caching, noisy
from dirl.runs.folder import Run
from dirl.training import hogwild
from dirl.training.build import build_imitation_loss
from dirl.training.job import Components, run_job
from dirl.training.loops import TrainState, Updates, dagger_rounds, imitation_steps, updates, write_evaluations
from dirl.training.objectives import (
    bootstrap,
    clip_gradients,
    demonstration_batches,
    make_advantages,
    minibatches,
    set_learning_rate,
)
from dirl.training.pairs import Demonstrations
from dirl.training.rollout import Report, collect, report
from dirl.training.stacked import Job, Stack, captured, run_together


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="train")
def main(composed: DictConfig | list[Job]) -> Any:
    """Train a run, or the jobs of a stack; returns the greedy SPL, which sweepers maximise, or those of all jobs."""
    if isinstance(composed, list):
        return run_together(composed, train, imitation, learn)
    return run_job(composed, train)["greedy"]["spl"]


def train(run: Run, components: Components) -> dict[str, Any]:
    """Imitation, then reinforcement; returns what the summary says of them (paper section 3, algorithm 1)."""
    state = captured(run, components) if run.config.device == "cuda" else components.state
    found = imitation([run], [components], components.policy if state is None else state.policy)
    return found if state is None else reinforce(run, state, components.protocol)


def imitation(runs: Sequence[Run], every: Sequence[Components], policy: ActorCritic | Stack) -> dict[str, Any]:
    """Clone the expert (paper section 3.3), unless the runs are beyond that; returns what the summary says of it.

    The policy is that of one run, or a stack of several.
    """
    demos, protocols, found = [own.demos for own in every], [own.protocol for own in every], dict[str, Any]()
    if not every[0].before_reinforcement:
        return found
    if len(demos[0]):
        step = imitate(runs, policy, demos)
        for labelled, frames in dagger_rounds(runs[0], every[0], demos[0]):  # Ross et al. 2011; none by default
            step = imitate(runs, policy, [labelled], step)
            found = {"frames": frames, "demonstrations": len(labelled)}
    if runs[0].config.evaluation.times:
        write_evaluations(runs, policy, protocols, 0)
    return found


def imitate(runs: Sequence[Run], policy: ActorCritic | Stack, demos: Sequence[Demonstrations], done: int = 0) -> int:
    """Clone the expert until its actions are learned (paper section 3.3); takes and returns the steps done so far."""
    config = runs[0].config
    if isinstance(policy, Stack):
        compare = policy.cloning()  # it has the demonstrations of its runs
    else:
        loss, trunk = build_imitation_loss(config, policy), policy.trunk()
        draw = demonstration_batches(policy, demos[0], config.imitation.batch_size)
    with imitation_steps(runs, policy, demos, done) as steps:

        def step() -> Tensor:
            with caching(policy, learns=True), noisy(policy, config.imitation.noise):
                # The policy with the expert, on a batch of demonstrations: equations 11 and 12.
                result = compare() if isinstance(policy, Stack) else loss(trunk(draw().copy()))
            steps.optimiser.zero_grad()
            result["loss_imitation"].sum().backward()
            steps.optimiser.step()
            return torch.stack([result["loss_imitation"], result["accuracy"]]).detach()

        # Of a stack on a GPU one CUDA graph.
        update = policy.prepared(step) if isinstance(policy, Stack) else step
        while steps.goes_on:
            set_learning_rate(steps.optimiser, steps.lr)
            steps.record(update())
    return steps.members[0].step


def reinforce(run: Run, state: TrainState | Stack, protocol: EvaluationProtocol) -> dict[str, Any]:
    """Improve the policy by actor-critic (paper section 3.2); returns what the summary says of the training."""
    improve: Callable[..., None] = hogwild.learn if run.config.reinforcement.workers > 1 else learn
    with updates(state, [run], [protocol]) as loop:
        improve(state, loop)
    return loop.members[0].summary


def learn(state: TrainState | Stack, loop: Updates) -> None:
    """Collect, losses, backward, clip, step; as long as the loop goes on.

    Where an episode ends, at the goal or by template matching (section 3.4), the environment decides.
    """
    options, policy, optimiser = state.config.reinforcement, state.policy, state.optimiser
    operator, advantages = policy.operator(), make_advantages(options.gamma, options.lmbda)
    critic = operator.get_value_operator()
    by_agent = bool(state.losses.recurrent)  # a memory needs the steps of an agent together and in order

    def step() -> Report:
        with caching(policy, learns=True):
            batch, agents = collect(state.env, operator, state.agents, options.n_steps)
            state.agents.update_(agents)
            batch = state.losses.rewarded(batch)  # the environment's reward, unless a loss defines one
            batch = advantages(bootstrap(batch, critic))  # equations 5 and 6
            for part in minibatches(batch, options.epochs, options.minibatches, by_agent=by_agent):
                losses = state.losses(part, state.left)  # equations 7 and 8, and 12 with a weight
                loss = sum(value for name, value in losses.items() if name.startswith("loss_"))
                optimiser.zero_grad()
                loss.sum().backward()  # over the runs, if they are a stack
                norm = clip_gradients(
                    state.parameters,
                    options.max_grad_norm,
                    per_variable=options.clip_per_variable,
                    stacked=state.stacked,
                )
                optimiser.step()
        return report(state.env, batch, losses.set("gradient_norm", norm).detach())

    update = state.prepared(step) if isinstance(state, Stack) else step  # of a stack on a GPU one CUDA graph
    while loop.goes_on:
        set_learning_rate(optimiser, optimiser.defaults["lr"] * state.left)  # falls linearly to 0
        loop.record(update())


if __name__ == "__main__":
    run(main)
