"""The end of a run: its evaluation, summary, weights and pictures."""

from typing import Any

from torch import nn

from dirl.config.components import packages_to_trust
from dirl.config.places import command
from dirl.evaluation.protocol import EvaluationProtocol, assess
from dirl.models import plain_weights
from dirl.recognition.build import matching
from dirl.reporting import draw_learning_curve, draw_scene, summary_table
from dirl.runs.folder import Run
from dirl.runs.memory import peak_memory_mb

DRAWN_SCENES = 8
"""Of how many scenes there are pictures at most; those of one take seconds."""


def conclude_untrained(
    run: Run, policy: nn.Module, protocol: EvaluationProtocol, facts: dict[str, Any]
) -> dict[str, Any]:
    """Evaluate a policy that learns nothing, and write the summary."""
    summary = facts | {"frames": 0, "seconds": run.seconds} | assess(policy, protocol)
    run.write_summary(summary)
    print(summary_table(summary))
    run.clean_up(summary)
    return summary


def conclude(run: Run, policy: Any, protocol: EvaluationProtocol, summary: dict[str, Any]) -> dict[str, Any]:
    """Evaluate, write the summary, show it as a table and in pictures."""
    if hasattr(policy, "restore"):
        policy.restore()
    measures = assess(policy, protocol)
    summary = summary | {"seconds": run.seconds, "peak_memory_mb": peak_memory_mb()} | measures
    run.finish({"frames": summary["frames"], "network": plain_weights(policy)}, summary)
    print(summary_table(summary))
    draw_learning_curve(run.folder, run.folder / "learning_curve.png")
    for index in range(min(DRAWN_SCENES, len(protocol.world.scenes))):
        draw_scene(policy, protocol, index, run.folder, matching=matching(run.config), facts=summary)
    run.clean_up(summary)
    print(f"pictures, metrics and weights: {run.folder}")
    if outside := packages_to_trust(run.config):
        print(f"evaluate it with: {command('evaluate')} checkpoint={run.folder} trust=[{','.join(outside)}]")
    return summary
