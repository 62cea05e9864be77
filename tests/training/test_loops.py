"""What the loops of the training refuse, and what they leave as it was."""

import pytest
from commands import room_file
from parts import make_parts, train_in

from dirl.config.schemas import ConfigError
from dirl.runs.finding import RunError

SMALL = ["encoder.width=8", "heads.width=8", "reinforcement.agents_per_scene=6", "evaluation.times=0"]
SMALL += ["reinforcement.frames_per_scene=2000"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (
            ["imitation.fraction=1", "imitation.lr=1e20"],
            "^the imitation has diverged: a loss of nan at step 1; lower imi",
        ),
        (
            ["imitation.fraction=0", "optimiser.lr=1e30"],
            "^the policy has diverged, its logits are not finite: lower imi",
        ),
    ],
    ids=["imitation", "reinforcement"],
)
def test_a_training_that_diverges_ends_in_one_line(tmp_path, options, says):
    parts = make_parts(f"scene={room_file(tmp_path)}", *SMALL, *options)
    with pytest.raises(RunError, match=says):
        train_in(tmp_path / "run", parts)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["optimiser.betas=[0.9]"], r"^optimiser\.betas=\[0\.9\]: \[1\]: is missing$"),
        (
            ["optimiser.foreach=true"],
            r"^optimiser: Adam refuses its options: `fused` and `foreach` cannot be `True` tog",
        ),
        (
            ["expert._target_=dirl.evaluation.experts.RandomPolicy"],
            r"^expert: RandomPolicy is no expert: it writes no ",
        ),
    ],
    ids=["betas", "foreach", "expert"],
)
def test_a_component_that_cannot_be_made_is_one_line(tmp_path, options, says):
    with pytest.raises(ConfigError, match=says):
        train_in(tmp_path / "run", make_parts(f"scene={room_file(tmp_path)}", *SMALL, *options))
