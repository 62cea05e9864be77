"""Options as users mistype them, drawn from the schemas and the groups of ``conf/``; by a random number generator."""

import importlib
from typing import get_args

from forks import ROOT

from dirl.config.schemas import TrainConfig, option_types

CONF = ROOT / "conf"

RECIPES = {name: importlib.import_module(name) for name in ("evaluate", "report", "map", "go", "benchmark", "scenes")}

SCHEMAS = {"train": TrainConfig} | RECIPES["scenes"].OPTIONS
SCHEMAS |= {name: recipe.Options for name, recipe in RECIPES.items() if name != "scenes"}
"""The options of every recipe, and of every command of ``recipes/scenes.py``."""

NOT_FINITE = ("nan", "inf", "-inf", "1e400", "-1e400")
VALUES = (
    *NOT_FINITE, "-1", "0", "1", "0.5", "1e-320", "1e15", "9" * 19, "9" * 40, "0x10", "1_0",
    "[]", "[1]", "[a,b]", "[[1,[2]]]", "[null]", "{}", "{a:{b:[1]}}", "{start:1,end:nan}", "{1:2}",
    "a,b", "1,2", "range(0,3)", "choice(1,2)", "glob(*)", "interval(0,1)", "shuffle(1,2)",
    "${seed}", "${nope}", "${oc.env:HOME}", "${oc.create:{a:1}}", "???", "${", "${a.${b}}", "${..seed}", "a${seed}b",
    "'", '"a', "[1", "{a:", "}", ")", "\\", "a:b", "a=b", "=", "a b", " ", "", "''", "','",
    "nope", "all", "true", "null", "~", "ünïcödé", "名前", "\u202eabc", "a\nb", "a\tb", "\x1b[31m", "%s{0}", "x" * 3000,
    "..", "../x", "a/b/c.h5", "x.h5", "collection:x", "every:0", "fraction:nan", "1:30", "_target_", "$x",
)  # fmt: skip
"""Numbers, lists and mappings, sweeps, interpolations, unbalanced quotes, texts and names of files."""

LIKELY = ("0", "1", "3", "17", "0.3", "1e-9", "true", "false", "null", "all", "cpu", "ncc", "x")
"""What some option takes."""

MALFORMED = (
    "=", "=5", "scene", "~scene", "~nope", "+", "++", "a.=1", ".a=1", "a..b=1", "a@b=c", "seed =1", "seed==1", "1=2",
    "[a]=1", "{}=1", "++nope=1", "+nope=1", "scene.a=1", "seed.a=1", "scene[0]=1", "hydra=1", "hydra.nope=1",
    "hydra/launcher=nope", "hydra.verbose=[", "hydra.sweeper=1", "hydra/nope=x", "hydra.mode=nope", "ß=1", "--nope",
    "-x", "--config-dir=nope", "--config-name=nope", "--cfg=nope", "--cfg", "--info=nope", "-m", "--package=nope",
    "--experimental-rerun=nope", "", " ", "?seed=1", "seed:1",
)  # fmt: skip

COMPONENTS = (
    "encoder.width", "encoder.nope", "encoder._target_", "encoder", "heads.nope.deep", "memory._target_",
    "optimiser.lr", "optimiser.betas", "optimiser._target_", "losses.a2c.gamma", "losses.a2c.entropy_coeff",
    "losses.a2c.weight", "losses.nope.weight", "losses.a2c", "losses.a2c._target_", "policy._target_", "expert.seed",
    "observation.goal_view", "episodic_memory._target_", "losses",
)  # fmt: skip
TARGETS = (
    "os.system", "nope.Nope", "torch.nn.Linear", "dirl.models.SiameseEncoder", "torch.optim.SGD", "dirl.models.nope",
    "dirl.evaluation.episodes.RandomPolicy", "a..b", ".", "builtins.eval", "5",
)  # fmt: skip


def base(recipe, files, tiny=()):
    """Arguments of a recipe, or a command of ``recipes/scenes.py``, that end well within a second or two.

    Args:
        recipe: a key of `SCHEMAS`.
        files: the folder with ``room.h5``, a finished run ``runs/fast/0`` and ``walk``.
        tiny: further options of a training.
    """
    room = f"scene={files / 'room.h5'}"
    small = ["height=16", "width=16", "encoder=null"]
    simulator = files / "simulator.yaml"
    if recipe == "simulator":
        simulator.write_text("_target_: dirl.sources.miniworld.MiniWorld\nenv: OneRoom\nheight: 16\nwidth: 16\n")
    return {
        "train": [room, *tiny, "hydra.run.dir=run"],
        "evaluate": [f"checkpoint={files / 'runs' / 'fast' / '0'}"],
        "report": ["experiment=table1", f"runs={files / 'runs'}", "out=report"],
        "thor": ["scene=FloorPlan401", "out=new.h5", *small],
        "vizdoom": ["map=map01", "out=new.h5", "places=2", *small],
        "miniworld": ["env=OneRoom", "out=new.h5", "places=2", *small],
        "simulator": [f"simulator={simulator}", "out=new.h5", "places=2", "encoder=null"],
        "draft": [f"folder={files / 'walk'}"],
        "photos": [f"folder={files / 'walk'}", "out=new.h5", *small],
        "tour": [f"path={files / 'tour'}", "out=new.h5", *small],
        "build": ["description=bathroom_02", "out=new.h5", *small, "fine=false"],
        "sample": ["kind=bathroom", "out=rooms", *small, "fine=false", "workers=1"],
        "encode": [room, "out=new.h5", "encoder=resnet50_small"],
        "export": [room, "out=new.h5"],
        "import": [room, "out=new.h5"],
        "inspect": [room],
        "map": [f"video={files / 'walk'}", "out=walk.pt"],
        "go": [f"map={files / 'walk.pt'}", f"photo={files / 'walk' / '6.png'}"],
    }[recipe]


def draw_arguments(rng, recipe):
    """One to three arguments of a recipe, most of them wrong.

    Args:
        rng: a `random.Random`.
        recipe: a key of `SCHEMAS`.
    """
    drawn = [_draw_argument(rng, recipe) for _ in range(rng.choice((1, 1, 1, 2, 3)))]
    return [*drawn, *(["-m"] if rng.random() < 0.06 else [])]


def _draw_argument(rng, recipe):
    """An option with any value, or its name misspelt; of a training also a component, or an option of one."""
    kinds = ["value"] * 12 + ["misspelt", "malformed"] * 2 + ["component", "choice"] * 2 * (recipe == "train")
    kind, name = rng.choice(kinds), rng.choice(list(option_types(SCHEMAS[recipe])))
    value = rng.choice(rng.choice((VALUES, VALUES, LIKELY)))
    if kind == "malformed":
        return rng.choice(MALFORMED)
    if kind == "misspelt":
        place = rng.randrange(len(name))
        wrong = rng.choice(("", name[place] * 2, "x", ".", "_", name[place].upper(), "/", "-", "é"))
        name = f"{name[:place]}{wrong}{name[place + 1 :]}"
    elif kind == "component":
        name = f"{rng.choice(('', '', '', '+', '++', '~'))}{rng.choice(COMPONENTS)}"
        value = rng.choice(TARGETS) if "_target_" in name else value
    elif kind == "choice":
        file = rng.choice(sorted(CONF.glob("*/*.yaml")))
        name, value = file.parent.name, rng.choice([file.stem, file.stem, f"[{file.stem}]", value])
    return f"{name}={value}"


def program(recipe):
    """The name of the program that a key of `SCHEMAS` is an option, or a command, of."""
    return "scenes" if recipe in RECIPES["scenes"].OPTIONS else recipe


def command_line(recipe, arguments, files, tiny=()):
    """The arguments of a recipe's program: the command of ``recipes/scenes.py``, flags, `base`, and these."""
    command = [recipe] if program(recipe) == "scenes" else []
    return [*command, *sorted([*base(recipe, files, tiny), *arguments], key=lambda word: not word.startswith("-"))]


def is_no_number(recipe, argument):
    """Whether an argument gives a number of the schema a value that is none."""
    name, _, value = argument.partition("=")
    kind = option_types(SCHEMAS[recipe]).get(name)
    return value in NOT_FINITE and bool({int, float} & {kind, *get_args(kind)})
