# SPDX-License-Identifier: Apache-2.0
"""Planning of paths, teams and regions."""
