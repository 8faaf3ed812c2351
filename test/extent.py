# SPDX-License-Identifier: Apache-2.0
"""How much the tests do: what fits before every change, or all with KBNITP_TESTS=full."""

import os

VARIABLE = 'KBNITP_TESTS'

FULL = os.environ.get(VARIABLE) == 'full'
