# SPDX-License-Identifier: Apache-2.0
"""The security policies of the package, and what of the graph they must allow."""

from collections import defaultdict
from fnmatch import fnmatchcase
from pathlib import Path
from xml.etree import ElementTree

from rclpy.action import get_action_client_names_and_types_by_node

FOLDER = Path(__file__).parents[2] / 'security'
FILES = sorted(FOLDER.glob('*.policy.xml'))

# By what a policy allows: how the graph is asked for it.
ASKED = {
    'publish': 'get_publisher_names_and_types_by_node',
    'subscribe': 'get_subscriber_names_and_types_by_node',
    'reply': 'get_service_names_and_types_by_node',
    'request': 'get_client_names_and_types_by_node',
}


def read_policy(path, replaced=('', '')):
    """Return the enclave of a policy, the full name of its node, and what it allows."""
    root = ElementTree.fromstring(path.read_text().replace(*replaced))
    (enclave,) = root.iter('enclave')
    (profile,) = enclave.findall('profiles/profile')
    return enclave.get('path'), *_allowed(profile)


def _allowed(profile):
    above = profile.get('ns').rstrip('/') + '/'
    node = above + profile.get('node')
    allowed = defaultdict(set)
    for group in profile.iter():
        for verb, rule in group.items():
            if rule == 'ALLOW':
                allowed[verb] |= {_full_name(above, node, each.text) for each in group}
    return node, allowed


def _full_name(above, node, name):
    if name.startswith('~'):
        return node + name[1:]
    return name if name.startswith('/') else above + name


def in_graph(looking, full_name):
    """Return what a node has in the graph, as another node sees it, by what it is allowed as."""
    namespace, _, name = full_name.rpartition('/')
    namespace = namespace or '/'
    found = {
        verb: {each for each, _ in getattr(looking, asked)(name, namespace)}
        for verb, asked in ASKED.items()
    }
    actions = get_action_client_names_and_types_by_node(looking, name, namespace)
    found['call'] = {each for each, _ in actions}
    # An action is several topics and services, which are allowed with it.
    return {
        verb: {each for each in names if '/_action/' not in each} for verb, names in found.items()
    }


def not_allowed(found, allowed):
    """Return what a node has in the graph and its policy does not allow."""
    return {
        (verb, name)
        for verb, names in found.items()
        for name in names
        if not any(fnmatchcase(name, each) for each in allowed[verb])
    }


def not_used(found, allowed):
    """Return what a policy allows and its node has not in the graph."""
    return {
        (verb, each)
        for verb, expressions in allowed.items()
        for each in expressions
        if not any(fnmatchcase(name, each) for name in found[verb])
    }
