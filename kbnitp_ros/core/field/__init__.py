# SPDX-License-Identifier: Apache-2.0
"""What is: the grid, the world, the sensors, and what is believed and observed of them."""
