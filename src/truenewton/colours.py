"""Colours that figures and pages share: even in lightness, alike to every kind of colour vision."""

from __future__ import annotations

COLOURS = "cividis"  # of values, in matplotlib; Bokeh writes it with a capital
SIGNED_COLOURS = "PuOr_r"  # of values about zero; negative purple, as in Bokeh
INK, FAINT, ACCENT, ALARM = "#1a1a1a", "#9a9a9a", "#00457c", "#a63603"
# Of several curves; they differ in lightness too, so that they stay apart in grey.
CURVES = ("#00457c", "#c8891c", "#4f8f6b", "#8c3d88", "#5c5c5c")
