# SPDX-License-Identifier: GPL-3.0-or-later
"""What the command line does: files in, files and reports out."""
