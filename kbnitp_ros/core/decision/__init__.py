# SPDX-License-Identifier: Apache-2.0
"""What may be relied on, where robots go for it, and when to stop."""
