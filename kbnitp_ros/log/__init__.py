# SPDX-License-Identifier: Apache-2.0
"""The mission log, an MCAP file: written, read and replayed."""
