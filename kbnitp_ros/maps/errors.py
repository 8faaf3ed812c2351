# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a map."""


class MapError(ValueError):
    """A map that cannot be used; the text names the file and what to change."""
