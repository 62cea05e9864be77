"""The reports of a run: tables, learning curves, pictures of paths, animations and the viewer."""

from dirl.reporting.curves import draw_learning_curve
from dirl.reporting.inspection import draw_contact_sheet, draw_scene_map
from dirl.reporting.maps import draw_policy
from dirl.reporting.pictures import draw_scene, write_gif
from dirl.reporting.tables import result_table, run_title, summary_table, write_goals
from dirl.reporting.trajectories import draw_paths, draw_trajectories
from dirl.reporting.viewer import viewer_pages

__all__ = [
    "draw_contact_sheet",
    "draw_learning_curve",
    "draw_paths",
    "draw_policy",
    "draw_scene",
    "draw_scene_map",
    "draw_trajectories",
    "result_table",
    "run_title",
    "summary_table",
    "viewer_pages",
    "write_gif",
    "write_goals",
]
