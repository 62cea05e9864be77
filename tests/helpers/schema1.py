"""What dirl 0.1 saved: configurations and weights of schema 1."""

CONFIG = """\
scene: bathroom_02
goals: null
seed: 0
device: cpu
precision: float32
resume: null
existing: refuse
system: dirl
preset: fast
policy: network
observation: surrounding
source:
  name: rooms
  root: null
network:
  heads: scene
  width: 512
  standardise: true
  axes: principal
imitation:
  share: 0.05
  rule: random
  lr: 0.0003
  max_steps: 300
  enough: 0.01
  keep: 0.3
  rounds: 0
  walk: 20
objective:
  name: a2c
  epochs: 1
  minibatches: 1
  clip: 0.2
optimiser:
  name: adam
  lr: 0.001
  eps: 1.0e-05
  max_norm: 1.0
  clip_each: false
reinforcement:
  frames_per_scene: 200000
  agents_per_scene: 64
  workers: 1
  steps: 5
  max_steps: 200
  gamma: 0.95
  lmbda: 0.95
  entropy: 0.02
  final_entropy: 0.01
  value: 1.0
  reduction: mean
reward:
  goal: 10.0
  step: -0.01
  collision: -0.1
  scale: 0.1
stop:
  training: goal
  evaluation: match
  threshold: 0.9
  match: views
evaluation:
  starts: every
  episodes_per_goal: 500
  max_steps: 200
  times: 10
checkpoint:
  every_seconds: 30.0
  keep: 2
logger:
  name: csv
  project: dirl
"""


def old_config(scene, **changes):
    """The text of a run's configuration in one scene, with other values, ``width=32`` for the first of that name."""
    lines = CONFIG.replace("scene: bathroom_02", f"scene: {scene}").splitlines()
    for name, value in changes.items():
        at = next(i for i, line in enumerate(lines) if line.strip().startswith(f"{name}:"))
        indent = lines[at][: len(lines[at]) - len(lines[at].lstrip())]
        lines[at] = f"{indent}{name}: {value}"
    return "\n".join(lines) + "\n"


def old_weights(weights):
    """A state_dict of today by the names of schema 1."""
    names = {"features.": "encoder.table.", "heads.trunk.": "hidden.", "heads.policy.": "policy."}
    names["heads.value."] = "value."
    found = {}
    for name, value in weights.items():
        new = next((prefix for prefix in names if name.startswith(prefix)), "")
        found[names.get(new, "") + name.removeprefix(new)] = value
    return found
