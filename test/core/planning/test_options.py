# SPDX-License-Identifier: Apache-2.0
"""An option of the search is stated in the table of parameters and in `SearchOptions` alone."""

import ast
from dataclasses import fields, replace

from documented import ROOT
from kbnitp_ros.configuration import parameters_of
from kbnitp_ros.configuration.mission import search_options
from kbnitp_ros.core import OBJECTIVES, PLANNERS, RobotType, SearchOptions
from laws import for_each

OPTIONS = {field.name: field for field in fields(SearchOptions)}
NAMES = {name: 'beam_width' if name == 'width' else name for name in OPTIONS}
ROWS = {option: parameters_of('planner')[name] for option, name in NAMES.items()}


def restated(source):
    """Yield the lines of functions and calls that name three options or more."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef):
            named = {each.arg for each in (*node.args.args, *node.args.kwonlyargs)}
        elif isinstance(node, ast.Call) and getattr(node.func, 'id', '') != 'SearchOptions':
            named = {each.arg for each in node.keywords}
        else:
            continue
        if len(named & OPTIONS.keys()) > 2:
            yield node.lineno


def test_the_table_has_each_option_with_its_default():
    assert {name: row.default for name, row in ROWS.items()} == vars(SearchOptions())
    values = {row.name: row.default for row in ROWS.values()}
    assert search_options(values) == SearchOptions()


@for_each('name', OPTIONS)
def test_the_planner_reads_each_parameter(name):
    others = {'planner': 'relaxed', 'objective': 'behavioral', 'alpha': 2.0}
    other = others[name] if name in others else getattr(SearchOptions(), name) + 1
    options = replace(SearchOptions(objective='behavioral'), **{name: other})
    values = {ROWS[each].name: value for each, value in vars(options).items()}
    assert search_options(values) == options


def test_the_table_allows_what_the_options_allow():
    assert set(ROWS['planner'].choices) == set(PLANNERS)
    assert tuple(ROWS['objective'].choices) == OBJECTIVES
    for name, row in ROWS.items():
        if row.limits:
            lowest, highest = row.limits
            for value in (lowest, highest):
                replace(SearchOptions(objective='behavioral'), **{name: value})


def test_robot_types_have_options_of_their_own():
    options = SearchOptions(max_steps=9).of_type(RobotType(max_steps=4, lethality=0.2))
    assert options == SearchOptions(max_steps=4)


def test_options_are_restated_nowhere_else():
    found = [
        f'{path.relative_to(ROOT)}:{line}'
        for path in sorted((ROOT / 'kbnitp_ros').rglob('*.py'))
        for line in restated(path.read_text())
    ]
    assert found == []


def test_a_restatement_is_found():
    assert list(restated('def f(width, *, alpha, planner): ...')) == [1]
    assert list(restated('f(width=1, alpha=1.0, max_steps=3)')) == [1]
    assert list(restated('SearchOptions(width=1, alpha=1.0, max_steps=3)')) == []
