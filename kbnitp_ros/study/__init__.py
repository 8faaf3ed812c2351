# SPDX-License-Identifier: Apache-2.0
"""Experiments over the core, and the figures of what came out."""
