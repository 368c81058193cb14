# SPDX-License-Identifier: GPL-3.0-or-later
"""What benchmarks write into the docs, and what they leave alone there."""

from importlib import util
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"


@pytest.fixture(scope="module")
def report():
    spec = util.spec_from_file_location("report", BENCHMARKS / "report.py")
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def page(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "By hand.\n<!-- speed -->\nold\n<!-- end of speed -->\nBetween.\n"
        "<!-- noise -->\n<!-- end of noise -->\nThe end.\n"
    )
    return page


def test_a_part_is_replaced_and_the_rest_stays(report, page):
    report.replace_part(page, "speed", "| new |\n")
    report.replace_part(page, "noise", "more")
    assert page.read_text() == (
        "By hand.\n<!-- speed -->\n| new |\n<!-- end of speed -->\nBetween.\n"
        "<!-- noise -->\nmore\n<!-- end of noise -->\nThe end.\n"
    )


def test_writing_twice_is_writing_once(report, page):
    report.replace_part(page, "speed", "new")
    once = page.read_text()
    report.replace_part(page, "speed", "new")
    assert page.read_text() == once


@pytest.mark.parametrize(
    "text",
    [
        "nothing",
        "<!-- speed --> and no end",
        "<!-- end of speed --> first <!-- speed -->",
        "<!-- speed --><!-- end of speed -->" * 2,
    ],
)
def test_a_page_without_the_two_marks_is_left_alone(report, page, text):
    page.write_text(text)
    with pytest.raises(ValueError, match="speed"):
        report.replace_part(page, "speed", "new")
    assert page.read_text() == text


def test_labels_of_methods_that_are_alike_stand_apart(report):
    places = {name: (5 + 0.01 * i, 0.2) for i, name in enumerate("abc")}
    places["exact"] = (5, 1e-4)
    labels = {name: offset for name, _, offset in report._labels(places)}
    assert set(labels) == set(places)
    assert len({labels[name] for name in "abc"}) == 3
    # In the order of their times, so that the lines to the places do not cross.
    assert labels["a"][1] > labels["b"][1] > labels["c"][1] == labels["exact"][1]
