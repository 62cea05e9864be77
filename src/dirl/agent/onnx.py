"""Export of a trained policy to ONNX, for machines without torch."""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch

from dirl.agent.images import NavigatorError
from dirl.agent.navigator import Navigator
from dirl.envs.transforms import VIEWS
from dirl.models import initial_state
from dirl.scenes.io.files import atomic_path


def export_onnx(navigator: Navigator, file: str | Path, opset: int | None = None) -> None:
    """Export the policy to ONNX: features to logits, value and matching coefficient, for any number of agents.

    Inputs are ``features`` and ``goal_features``, float32 ``[B, 4, D]`` as the backbone returns them; outputs
    ``logits`` ``[B, 4]``, ``value`` ``[B, 1]`` and ``matching`` ``[B]``. A policy with memory also takes its recurrent
    state (zeros at the beginning of an episode) and returns the next one as ``next_<name>``. The layers are those of
    the navigator's scene. The file's metadata holds ``scene``, ``extractor``, ``views`` (their order) and
    ``threshold``. It does not contain the encoder. ``opset`` is the version of ONNX's operators that the runtime knows;
    that which torch prefers if left out.

    Raises:
        NavigatorError: a package that the export needs is not installed, or torch cannot export for this version.
    """
    try:
        import onnx  # noqa: F401
        import onnxscript  # noqa: F401
    except ImportError as error:
        raise NavigatorError(
            f"the export needs packages that are not installed ({error}): pip install 'dirl[onnx]'"
        ) from None
    # Two rows, because torch treats a dimension of one as a constant; two tensors, because it merges identical inputs.
    features, goal_features = (torch.zeros(2, VIEWS, navigator.width, device=navigator.device) for _ in range(2))
    state = initial_state(navigator.policy.policy, 2, navigator.device)
    batch = {0: torch.export.Dim("batch")}
    with _quiet():
        program = torch.onnx.export(
            navigator.policy,
            (features, goal_features, *state.values()),
            input_names=["features", "goal_features", *state],
            output_names=["logits", "value", "matching", *(f"next_{name}" for name in state)],
            dynamic_shapes={"features": batch, "goal_features": batch}
            | ({"state": (batch,) * len(state)} if state else {}),
            opset_version=opset,
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    if opset not in (None, exported := program.model.opset_imports[""]):  # torch goes back to another with a warning
        raise NavigatorError(f"opset={opset}: torch cannot export this policy for it, but for {exported}")
    views = ",".join(navigator.view_order)
    program.model.metadata_props.update(navigator.facts | {"views": views, "threshold": str(navigator.threshold)})
    with atomic_path(Path(file)) as temporary:
        program.save(str(temporary), external_data=False)


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress warnings about deprecated functions of torch, a missing torchvision, and an operator set in vain."""
    logs = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript")]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.setLevel(level)
