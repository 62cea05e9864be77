"""Outcomes of a campaign as a table."""


def table(counts, title, outcomes):
    """How often each kind had each outcome, Markdown; ``counts`` by pairs of a kind and an outcome."""
    lines = [f"| {title} | tried | " + " | ".join(outcomes) + " |", "|---|" + "--:|" * (len(outcomes) + 1)]
    for kind in [*sorted({kind for kind, _ in counts}), "all"]:
        numbers = [sum(n for (k, o), n in counts.items() if o == what and kind in (k, "all")) for what in outcomes]
        lines.append(f"| {kind} | {sum(numbers)} | " + " | ".join(map(str, numbers)) + " |")
    return "\n".join(lines)
