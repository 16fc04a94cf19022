"""Error messages as a terminal shows them."""

import pytest

from bp2_rl.base.errors import LONGEST_LINE, one_line


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("two\nlines\r\nand  a\ttab", "two lines and a tab"),
        ("no UTF-8: \udcff", r"no UTF-8: \udcff"),
        ("red: \x1b[31m, title: \x1b]0;x\x07", r"red: \x1b[31m, title: \x1b]0;x\x07"),
        (
            "NUL \0, DEL \x7f, C1 \x9b, right to left \u202e",
            r"NUL \x00, DEL \x7f, C1 \x9b, right to left \u202e",
        ),
        ("10 m/s², ä, 犬", "10 m/s², ä, 犬"),
    ],
)
def test_a_message_is_a_line_that_steers_no_terminal(text, line):
    assert one_line(text) == line


def test_of_a_message_that_is_very_long_the_middle_is_left_out():
    line = one_line(f"begin {'x' * 100_000} end")
    assert len(line) == LONGEST_LINE + len(" ... ")
    assert line.startswith("begin x")
    assert line.endswith("x end")
    assert one_line("x" * LONGEST_LINE) == "x" * LONGEST_LINE
