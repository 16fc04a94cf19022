"""All rows of the index, in the order of the paper, and then what goes beyond it."""

from bp2_rl.paper.index import experiments, main_text, supplement
from bp2_rl.paper.index.item import Item

GROUPS: dict[str, tuple[Item, ...]] = {
    "Figures": (
        *main_text.FIGURE_1,
        *main_text.FIGURE_2,
        *main_text.FIGURE_3,
        *main_text.FIGURE_4,
        *experiments.FIGURE_5,
        *experiments.FIGURE_6,
        *experiments.FIGURE_7,
        *supplement.FIGURE_S1,
        *supplement.FIGURE_S2,
    ),
    "Tables": supplement.TABLES,
    "Equations": supplement.EQUATIONS,
    "Movies": supplement.MOVIES,
    "Beyond the paper's items": supplement.BEYOND,
}
"""Rows by heading; an item that is `beyond` is none of the paper's."""
