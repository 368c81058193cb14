# SPDX-License-Identifier: GPL-3.0-or-later
"""The examples in the docstrings run and print what they say."""

import doctest
import pkgutil
from importlib import import_module

import pytest

import core

MODULES = [module.name for module in pkgutil.walk_packages(core.__path__, "core.")]


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    failed, _ = doctest.testmod(
        import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE
    )
    assert not failed


def test_there_are_examples():
    parser = doctest.DocTestFinder()
    found = [
        test.name
        for name in MODULES
        for test in parser.find(import_module(name))
        if test.examples
    ]
    assert len(found) >= 3
