# SPDX-License-Identifier: GPL-3.0-or-later
"""Which side of a surface is out."""
