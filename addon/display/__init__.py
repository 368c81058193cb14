# SPDX-License-Identifier: GPL-3.0-or-later
"""What is seen of results: colors, lines, legends, single points, pictures."""
