"""The items of a paper in LaTeX: its figures' panels, tables, equations and movies, as
ids of the index."""

import re

SUPPLEMENT = r"\setcounter{figure}{0}"
"""From here on numbers begin anew, with an S before them."""


def paper_items(tex: str) -> list[str]:
    """Return the ids of a paper's items in order: fig-4-a, or fig-2 where a caption
    names no panels; table-s1; eq-3; movie-s2.

    Panels are what a caption has in bold: a letter, several, or a range. A table
    without a caption has no number: it belongs to the one before.
    """
    ids: list[str] = []
    for prefix, part in zip(("", "s"), tex.split(SUPPLEMENT), strict=True):
        counts = {"figure": 0, "table": 0, "equation": 0}
        for kind, body in re.findall(
            r"\\begin\{(figure|table|equation)\}(.*?)\\end\{\1\}", part, re.DOTALL
        ):
            if kind == "table" and r"\caption" not in body:
                ids.append(f"{ids[-1]}-symbols")
                continue
            counts[kind] += 1
            name = f"{ {'figure': 'fig', 'table': 'table', 'equation': 'eq'}[kind] }-{prefix}{counts[kind]}"
            ids += (
                [f"{name}-{panel}" for panel in _panels(body)]
                if kind == "figure"
                else []
            )
            ids += [] if kind == "figure" and _panels(body) else [name]
            ids += [f"{name}-inset"] if re.search(r"\binset\b", body) else []
    movies = {
        number
        for run in re.findall(r"Movies?[~ ](S\d)(?: (?:and|to) (S\d))?", tex)
        for number in run
        if number
    }
    first, last = (int(end[1:]) for end in (min(movies), max(movies)))
    return ids + [f"movie-s{number}" for number in range(first, last + 1)]


def _panels(caption: str) -> list[str]:
    letters: list[str] = []
    for bold in re.findall(r"\\textbf\{([A-Z](?:[-, ]+[A-Z])*)\}", caption):
        ends = re.findall("[A-Z]", bold)
        letters += (
            [chr(code) for code in range(ord(ends[0]), ord(ends[-1]) + 1)]
            if "-" in bold
            else ends
        )
    return [letter.lower() for letter in sorted(set(letters))]
