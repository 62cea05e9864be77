"""Sharing trained policies through the Hugging Face Hub or as plain folders: weights, configuration and a card."""

import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

from dirl.agent.hub import HubError, first_line, hub_library
from dirl.perception.backbones import EncoderError
from dirl.perception.backbones.registry import packaged_encoder
from dirl.reporting.tables import run_title, summary_table
from dirl.runs.checkpoints import load_checkpoint
from dirl.runs.export import write_shared
from dirl.runs.schema import Summary
from dirl.scenes.io.bounded import read_text

CARD = """---
library_name: dirl
license: {license}
pipeline_tag: reinforcement-learning
tags: [visual-navigation, imitation-learning, torchrl]
model-index: {index}
---

# {title}

Target-driven visual navigation: given the views around an agent and those of its goal, the next move. Trained by
dirl, an implementation of [Fang et al. 2022](https://doi.org/10.1049/cit2.12043): system `{system}`, preset
`{preset}`, seed {seed}, {frames:,} frames.

```python
from dirl import Navigator  # pip install 'dirl[hub]'

navigator = Navigator.from_pretrained("{name}", {encoder})
```

It was trained on the image features of: {extractor}. {meaning}All options
of the training are in `config.yaml`, all measurements in `summary.json`.

## Numbers

{table}

{pictures}
## Licence

{license}. {note}
"""


ROOMS = (
    "The scenes are synthetic rooms; compare these numbers with each other, not with those of other simulators. Their "
    "features were computed with weights under CC BY-NC 4.0."
)


def save_pretrained(run: str | Path, folder: str | Path, *, name: str = "", license: str = "cc-by-nc-4.0") -> Path:
    """Write the policy of a finished run and its card to a folder that can be shared.

    Args:
        run: the folder of the run.
        folder: a new or empty one.
        name: under which others will load it, for the card; if empty, the folder.
        license: of the weights, as the Hub writes it. The default is that of the weights which the features of the
            built-in rooms were computed with.

    Raises:
        HubError: the run is not finished, or the folder is not empty.
        RunError: the run's weights cannot be read, or safetensors is not installed.
    """
    run, folder = Path(run), Path(folder)
    if not (run / "summary.json").is_file() or not (run / "network.pt").is_file():
        raise HubError(f"{run}: is not the folder of a finished run with weights; train first, or resume the run")
    if folder.exists() and any(folder.iterdir()):
        raise HubError(f"{folder}: is not empty; choose a new folder")
    saved, summary = load_checkpoint(run), json.loads(read_text(run / "summary.json"))
    folder.mkdir(parents=True, exist_ok=True)
    write_shared(saved, folder)
    pictures = sorted([*run.glob("*.png"), *run.glob("*.gif")])
    for file in (run / "summary.json", *pictures):
        shutil.copy(file, folder)
    text = model_card(summary, saved["extractor"], [file.name for file in pictures], name or str(folder), license)
    (folder / "README.md").write_text(text, encoding="utf-8")
    return folder


def model_card(summary: Summary, extractor: str, pictures: list[str], name: str, license: str) -> str:
    """Return the card of a policy, Markdown with the Hub's header: scene, system, numbers, pictures, licence."""
    encoder, meaning = _encoder(extractor)
    shown = "".join(f"![{picture.rpartition('.')[0].replace('_', ' ')}]({picture})\n" for picture in pictures)
    facts = {key: summary[key] for key in ("system", "preset", "seed", "frames")}
    return CARD.format(
        **facts,
        index=json.dumps(_index(summary, name)),
        title=run_title(summary),
        extractor=extractor,
        encoder=encoder,
        meaning=meaning,
        table=summary_table(summary),
        pictures=shown,
        name=name,
        license=license,
        note=ROOMS if summary["source"] == "rooms" else "",
    )


def _index(summary: Summary, name: str) -> list[dict[str, Any]]:
    """Return the greedy measures in the form that the Hub reads, JSON being YAML."""
    measured = {key: round(summary["greedy"][key], 4) for key in ("sr", "spl")}
    result = {
        "task": {"type": "reinforcement-learning", "name": "target-driven visual navigation"},
        "dataset": {"name": str(summary["scene"]), "type": "scenes"},
        "metrics": [{"type": key, "name": f"{key.upper()}, greedy", "value": one} for key, one in measured.items()],
    }
    return [{"name": name, "results": [result]}]


def _encoder(extractor: str) -> tuple[str, str]:
    """Return the arguments by which a navigator gets an extractor's encoder, and what they mean if it is not dirl's."""
    try:
        name = packaged_encoder(extractor)
    except EncoderError:  # its weights are not installed here
        name = None
    if name is not None:
        return f'"{name}"', ""
    return "encoder, extractor=extractor", "`extractor` is this text, `encoder` a function of images to features. "


def push_to_hub(run: str | Path, name: str, *, private: bool = False, license: str = "cc-by-nc-4.0") -> str:
    """Upload the policy of a finished run to the Hub as ``user/name``; log in first with ``hf auth login``.

    Returns:
        The address of the commit.

    Raises:
        HubError: huggingface_hub is not installed, the Hub refuses the upload, or see `save_pretrained`.
    """
    hub = hub_library()
    with tempfile.TemporaryDirectory() as folder:
        save_pretrained(run, folder, name=name, license=license)
        try:
            api = hub.HfApi()
            api.create_repo(name, private=private, exist_ok=True)
            commit = api.upload_folder(repo_id=name, folder_path=folder, commit_message="Trained with dirl")
        except (OSError, ValueError) as error:  # the base classes of the library's errors
            raise HubError(f"{name}: {first_line(error)}") from None
    return str(commit)
