"""The colours of figures and maps; without matplotlib, for environments that render."""

# The Okabe-Ito palette, which colour-blind readers can tell apart; its yellow is the goal's on maps.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")

BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE = COLORS

GREY, WINE, OLIVE = "#999999", "#882255", "#999933"

SYSTEM_COLORS = {
    "dirl": BLUE,
    "td_drl": VERMILION,
    "a3c": GREEN,
    "dirl_ppo": PURPLE,
    "il": SKY,
    "dagger": ORANGE,
    "dirl_compared": OLIVE,
    "any_goal": WINE,
    "random": GREY,
    "shortest_path": "#000000",
}
"""By name of the preset ``system``; the same in every figure."""

GOAL_COLOR, WALL_COLOR = "#F0E442", "#C9CDD3"
