# SPDX-License-Identifier: GPL-3.0-or-later
"""Patches of many sizes at every point, and what is made of them."""
