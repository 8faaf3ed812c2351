# SPDX-License-Identifier: Apache-2.0
"""Informative path planning from robots that do not all come back."""
