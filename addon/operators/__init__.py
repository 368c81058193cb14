# SPDX-License-Identifier: GPL-3.0-or-later
"""What is done to objects on request, and how its jobs run beside the window."""
