# SPDX-License-Identifier: Apache-2.0
"""Without gymnasium the environments name what installs it."""

from importlib import import_module
import sys

import pytest


def test_without_gymnasium_the_extra_is_named(monkeypatch):
    monkeypatch.delitem(sys.modules, 'kbnitp_ros.environments', raising=False)
    for name in ('gymnasium', 'gymnasium.envs.registration'):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install '/.*\[environments\]'$"):
        import_module('kbnitp_ros.environments')
