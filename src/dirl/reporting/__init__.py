"""What a run turns into for a reader: tables, learning curves, pictures of the paths walked."""

from dirl.reporting.curves import draw_learning_curve
from dirl.reporting.tables import result_table, run_title, summary_table
from dirl.reporting.trajectories import draw_trajectories

__all__ = ["draw_learning_curve", "draw_trajectories", "result_table", "run_title", "summary_table"]
