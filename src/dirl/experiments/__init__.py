"""The paper's tables and figures from finished runs: ``recipes/report.py`` writes them."""
