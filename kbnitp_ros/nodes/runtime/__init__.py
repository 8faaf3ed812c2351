# SPDX-License-Identifier: Apache-2.0
"""Common to all nodes: executor, signals, quality of service, diagnostics, parameters."""
