# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's experiment again, as tables and as figures."""
