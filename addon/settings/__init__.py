# SPDX-License-Identifier: GPL-3.0-or-later
"""What can be chosen: its names, its limits, and where a scene keeps it."""
