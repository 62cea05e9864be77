"""Pictures of a trained policy in one scene: episodes as a figure and as GIF, and maps of the policy."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont
from torch import nn

from dirl.agent.decisions import answers
from dirl.envs.rendering import RoomMap
from dirl.evaluation.protocol import EvaluationProtocol
from dirl.perception.recognition.recogniser import TemplateStop
from dirl.reporting.maps import draw_policy
from dirl.reporting.trajectories import draw_paths, path_actions
from dirl.runs.checkpoints import Summary
from dirl.scenes import Scene
from dirl.scenes.io.files import atomic_path
from dirl.scenes.palette import COLORS, GOAL_COLOR

MAX_FRAMES = 60
"""Number of frames; of a longer episode the first steps and the last one are shown."""

FRAME_MS, HOLD_MS = 400, 2500
"""How long a step is shown, and the last one; milliseconds."""

MAP_SIZE, VIEW_WIDTH, GAP, LINE = 300, 190, 12, 20
"""Pixels: longer side of the map, width of a view, space between them, height of a line of text."""

SMOOTH = 3
"""See `RoomMap`."""


def draw_scene(
    policy: nn.Module, protocol: EvaluationProtocol, index: int, folder: Path, *, matching: TemplateStop, facts: Summary
) -> None:
    """Draw a scene's first goal: greedy episodes, that of the farthest start as a GIF; maps of the policy.

    The scene is given by its place in the world, the ``facts`` are `dirl.training.build.describe`'s of the run.
    """
    world, scene = protocol.world, protocol.world.scenes[index]
    goal_index = world.goals_of[index][0]
    file = folder / f"trajectories_{scene.name}.png"
    goal, walked, success, title = draw_paths(policy, protocol, index, file, facts=facts)
    write_gif(scene, goal, walked, folder / f"episode_{scene.name}.gif", title=title, success=success)
    logits, value = answers(policy, world, protocol.observation, goal_index)
    draw_policy(
        scene,
        goal,
        logits.cpu(),
        value.cpu(),
        world.block(matching.scores(world), goal_index).cpu(),
        folder / f"maps_{scene.name}.png",
        title=title,
        threshold=matching.threshold,
    )


def write_gif(scene: Scene, goal: int, path: Sequence[int], file: Path, *, title: str, success: bool) -> None:
    """Write an episode as an animated GIF, a frame a state: present view, goal's view, map with the path.

    Of one that is longer than `MAX_FRAMES` the first states and the last one are shown, of a scene without views only
    the map. The path is all states from the start to the end; one that follows itself is a blocked move. ``success``
    says whether it ended in a stop at the goal.

    Raises:
        ValueError: the path is empty or makes a step that the scene's graph does not allow, or the goal is no state
            that can be reached.
    """
    scene.check_goals([goal])
    steps = len(path) - 1
    actions = [*path_actions(scene, path), "goal reached" if success else "failed"]
    shown = [*range(min(steps, MAX_FRAMES - 1)), steps]
    room = RoomMap(scene, goal, (MAP_SIZE, MAP_SIZE), SMOOTH)
    views = {}
    if scene.views is not None:
        for state in {goal, *(path[step] for step in shown)}:
            view = Image.fromarray(scene.views[state])
            size = VIEW_WIDTH, round(VIEW_WIDTH * view.height / view.width)
            views[state] = view.resize(size, Image.Resampling.LANCZOS)
    frames = [_frame(views, goal, path, step, actions[step], room, title) for step in shown]
    # One palette for all frames and no dithering, so that unchanged regions take no space.
    sample = Image.new("RGB", (frames[0].width, 4 * frames[0].height))
    for row, which in enumerate((0, len(frames) // 2, len(frames) - 1)):
        sample.paste(frames[which], (0, row * frames[0].height))
    # Otherwise the many colours of the views would displace those of the few pixels of the markers.
    for place, color in enumerate((*COLORS, GOAL_COLOR)):
        sample.paste(color, (40 * place, 3 * frames[0].height, 40 * (place + 1), 4 * frames[0].height))
    palette = sample.reduce(3).quantize(128, method=Image.Quantize.MEDIANCUT)  # the time grows with the pixels
    first, *rest = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    durations = [FRAME_MS] * (len(frames) - 1) + [HOLD_MS]
    with atomic_path(file) as temporary:
        first.save(temporary, "GIF", save_all=True, append_images=rest, duration=durations, loop=0, optimize=False)


def _frame(
    thumbnails: Mapping[int, Image.Image],
    goal: int,
    path: Sequence[int],
    step: int,
    action: str,
    room: RoomMap,
    title: str,
) -> Image.Image:
    """Return the picture of one step; ``thumbnails`` are the views of the states that are shown, if there are any."""
    ended = step == len(path) - 1
    color = (COLORS[2] if action == "goal reached" else COLORS[1]) if ended else COLORS[0]
    picture = room.draw(path[: step + 1], color)
    height = picture.height
    named = {"what it sees": path[step], "the goal's view": goal} if thumbnails else {}
    views = [(name, thumbnails[state]) for name, state in named.items()]
    if views:
        height = max(height, sum(view.height + LINE for _, view in views) + GAP)
    caption = f"step {step} of {len(path) - 1}: {action}"
    big, small = ImageFont.load_default(14), ImageFont.load_default(13)
    left = picture.width + 2 * GAP
    width = max(
        left + (VIEW_WIDTH + GAP if views else 0), *(int(big.getlength(text)) + 2 * GAP for text in (title, caption))
    )
    frame = Image.new("RGB", (width, height + 2 * LINE + 3 * GAP), "white")
    draw = ImageDraw.Draw(frame)
    draw.text((GAP, GAP), title, fill="black", font=big)
    draw.text((GAP, GAP + LINE), caption, fill=color if ended else "#444444", font=small)
    top = 2 * GAP + 2 * LINE
    frame.paste(picture, (GAP, top))
    for name, view in views:
        draw.text((left, top), name, fill="#444444", font=small)
        frame.paste(view, (left, top + LINE))
        if ended and name == "what it sees":
            box = (left, top + LINE, left + view.width - 1, top + LINE + view.height - 1)
            draw.rectangle(box, outline=color, width=3)
        top += LINE + view.height + GAP
    return frame
