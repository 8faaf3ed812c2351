# SPDX-License-Identifier: Apache-2.0
"""What a mission's log comes to, for people and for other programs."""
