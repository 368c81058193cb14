# SPDX-License-Identifier: GPL-3.0-or-later
"""Clouds larger than memory: in tiles on disk, computed here or on a cluster."""
