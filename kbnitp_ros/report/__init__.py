# SPDX-License-Identifier: Apache-2.0
"""Reports of a mission's log: pages, figures, tables and maps."""
