# SPDX-License-Identifier: GPL-3.0-or-later
"""Patches of one size around points: charts, fits, their size, their sheets."""
