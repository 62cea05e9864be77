"""The paper's tables and figures, and measurements of agents: what ``recipes/report.py`` writes.

Each ``report_...`` takes finished runs (`dirl.experiments.results.finished_runs`) and a note, what a reader must know
of them, or agents (`dirl.runs.checkpoints.load_checkpoint`) and where they walk; and the folder ``out``. It writes CSV
files, figures and ``README.md`` there, and returns the text of the latter.
"""
