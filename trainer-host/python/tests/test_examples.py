"""Runs the examples, and the lines that the package shows in its own description."""

import doctest
import pathlib
import runpy

import pytest

import dgs

EXAMPLES = sorted((pathlib.Path(__file__).parent.parent / "examples").glob("*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run(path: pathlib.Path) -> None:
    runpy.run_path(str(path))


def test_there_are_examples() -> None:
    assert EXAMPLES


def test_the_description_is_true() -> None:
    found = doctest.testmod(dgs)
    assert found.attempted > 4 and found.failed == 0
