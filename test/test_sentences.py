# SPDX-License-Identifier: Apache-2.0
"""No part decides on a sentence that another part wrote for people."""

import ast
from functools import cache
from pathlib import Path

from kbnitp_msgs import msg, srv
import pytest
from rosidl_parser.definition import UnboundedString

PACKAGE = Path(__file__).parents[1] / 'kbnitp_ros'

# Modules that decide. Only the planner has the module of words, to say what it waits for.
WORDS = PACKAGE / 'base/obstacles.py'
DECIDING = [
    path
    for folder in ('base', 'nodes', 'log')
    for path in sorted(PACKAGE.joinpath(folder).rglob('*.py'))
    if path != WORDS
] + [PACKAGE / 'cli/demo_mission.py']

# Text fields of messages and services: those for people, and those that name something.
FOR_PEOPLE = {'reason', 'message'}
NAMES = {
    'agent', 'author', 'dynamics', 'field_id', 'goal', 'instance', 'journal', 'log', 'method',
    'name', 'target_dynamics', 'told', 'agents', 'parameters', 'kind', 'alternative',
    'version', 'waiting', 'held', 'note', 'out',
}  # fmt: skip

# Attributes with a text for people, beside fields of messages: of standings, of nodes on
# /diagnostics, and of the planner's state. None says that there is no text.
TEXTS = FOR_PEOPLE | {
    'why', 'words', 'missing_listeners', 'unrecorded_action', 'why_over', 'why_unfollowed',
}  # fmt: skip
DIAGNOSTICS = 'diagnostics.state'
SEARCHES = {
    'count', 'endswith', 'find', 'fullmatch', 'index', 'match', 'partition', 'removeprefix',
    'removesuffix', 'rpartition', 'search', 'split', 'startswith',
}  # fmt: skip

# Functions that make a text of a text, log it once, or compare it with the record.
WRITERS = {
    'base/agent_states.py': {'why_not_lost', 'words'},
    'base/preflight.py': {'pose_check', 'robot_checks'},
    'log/replay.py': {'standing_difference'},
    'log/replayed.py': {'__str__'},
    'nodes/dispatch.py': {'follow', 'log_reasons', '_on_state'},
    'nodes/goal.py': {'why_over'},
    'nodes/newest_belief.py': {'_on_standings'},
}
# An agent has no value by which it says that its robot was mended.
UNDECIDED = {'base/agent_states.py': {'take'}}


def conditions(node):
    """Yield the expressions on whose values a node decides."""
    match node:
        case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
            yield test
        case ast.Assert(test=test):
            yield test
        case ast.BoolOp(values=values):
            yield from values
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield operand
        case ast.comprehension(ifs=ifs):
            yield from ifs
        case ast.Match(subject=subject):
            yield subject
        case ast.Compare(left=left, ops=ops, comparators=others):
            # None is a value.
            if not any(isinstance(each, ast.Is | ast.IsNot) for each in ops):
                yield from (left, *others)
        case ast.Call(func=ast.Name(id='bool' | 'len'), args=args):
            yield from args
        case ast.Call(func=ast.Attribute(attr=name, value=value), args=args) if name in SEARCHES:
            yield from (value, *args)


def is_text(node):
    """Return whether an expression is a text for people."""
    match node:
        case ast.NamedExpr(value=value) | ast.Call(func=value) | ast.Subscript(value=value):
            return is_text(value)
        case ast.Attribute(attr=name):
            return name in TEXTS or ast.unparse(node).endswith(DIAGNOSTICS)
        case ast.Name(id=name):
            # Local names of texts.
            return name in TEXTS - {'message'}
    return False


def decisions(tree):
    """Yield the function and the line of each decision on a text for people."""

    def visit(node, function):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            function = node.name
        for expression in conditions(node):
            if is_text(expression):
                yield function, expression.lineno
        for child in ast.iter_child_nodes(node):
            yield from visit(child, function)

    return [*visit(tree, '')]


@cache
def found():
    """Return the decisions on texts in each deciding module, by function."""
    known = {}
    for path in DECIDING:
        functions = {name for name, _ in decisions(ast.parse(path.read_text()))}
        if functions:
            known[str(path.relative_to(PACKAGE))] = functions
    return known


def test_nothing_decides_on_a_text_for_people():
    allowed = {
        name: WRITERS.get(name, set()) | UNDECIDED.get(name, set())
        for name in WRITERS.keys() | UNDECIDED
    }
    assert found() == {name: functions for name, functions in allowed.items() if functions}


@pytest.mark.parametrize('planted', [
    'if state.reason: pass',
    'if not state.reason: pass',
    'x = state.reason == "base differs"',
    'x = "departed" in answer.message',
    'x = answer.message.startswith("waiting for")',
    'x = re.search("lost", standing.why)',
    'x = [each for each in states if each.reason]',
    'x = 1 if now.why_over() else 2',
    'while why := standing.why: pass',
    'x = bool(self.diagnostics.state)',
    'x = self.diagnostics.state.removeprefix("waiting for ")',
    'assert state.reason and other',
])  # fmt: skip
def test_a_decision_on_a_sentence_is_found(planted):
    assert decisions(ast.parse(f'def decide():\n    {planted}')) == [('decide', 2)]


@pytest.mark.parametrize('harmless', [
    'if now.why_over() is not None: pass',
    'x = f"{agent} says: {state.reason}"',
    'self.diagnostics.state = waiting_for(state.reason)',
    'if state.readiness is Readiness.READY: say(state.reason)',
])  # fmt: skip
def test_a_sentence_that_is_passed_on_is_no_decision(harmless):
    assert decisions(ast.parse(f'def decide():\n    {harmless}')) == []


def test_every_text_field_is_for_people_or_a_name():
    kinds = [getattr(msg, name) for name in dir(msg) if name[0].isupper()]
    for name in dir(srv):
        service = getattr(srv, name)
        if not hasattr(service, 'Request'):
            continue
        kinds += [service.Request, service.Response]
    texts = set()
    for kind in kinds:
        for name, slot in zip(kind.get_fields_and_field_types(), kind.SLOT_TYPES):
            if isinstance(getattr(slot, 'value_type', slot), UnboundedString):
                texts.add(name)
    assert texts == FOR_PEOPLE | NAMES


def test_the_module_of_words_decides_nothing():
    users = {
        (str(path.relative_to(PACKAGE)), alias.name)
        for path in DECIDING
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module == 'kbnitp_ros.base.obstacles'
        for alias in node.names
    }
    assert users == {('nodes/planner.py', 'describe_obstacle')}
