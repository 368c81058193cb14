# SPDX-License-Identifier: GPL-3.0-or-later
"""What the faces of a mesh know."""
