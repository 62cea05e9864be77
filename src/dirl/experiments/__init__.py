"""The paper's tables and figures: what ``recipes/report.py`` writes.

Each ``report_...`` takes finished runs (`dirl.experiments.results.finished_runs`), a note, what a reader must know of
them, and the folder ``out``. It writes CSV files, figures and ``README.md`` there, and returns the text of the latter.
"""
