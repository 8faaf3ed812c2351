# SPDX-License-Identifier: Apache-2.0
"""Decisions on goals, flights for goals, and when to stop."""
