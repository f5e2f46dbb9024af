"""Keys of the preview: their names, their actions, and the help text."""

from __future__ import annotations

ACTIONS: dict[str, str] = {
    "1": "mono",
    "2": "side_by_side",
    "3": "anaglyph",
    "space": "play",
    ".": "next_frame",
    ",": "previous_frame",
    "M": "next_motion",
    "[": "previous_joint",
    "]": "next_joint",
    "backspace": "straighten",
    "R": "reset_view",
    "P": "screenshot",
    "O": "toggle_numbers",
    "H": "toggle_help",
    "escape": "quit",
}
"""Key -> method of Viewer."""

FLIGHT: dict[str, tuple[float, float, float]] = {
    "W": (0, 0, 1),
    "S": (0, 0, -1),
    "A": (-1, 0, 0),
    "D": (1, 0, 0),
    "E": (0, 1, 0),
    "Q": (0, -1, 0),
}
"""Key -> direction (right, up, forward) of flight while it is held."""

TURNS: dict[str, tuple[float, float, float]] = {
    "up": (-1, 0, 0),
    "down": (1, 0, 0),
    "left": (0, -1, 0),
    "right": (0, 1, 0),
    "page up": (0, 0, 1),
    "page down": (0, 0, -1),
}
"""Key -> axis about which the selected joint turns, in the joint's frame."""

HELP_LINES: tuple[tuple[str, str], ...] = (
    ("1  2  3", "mono, side by side, anaglyph (red left, cyan right)"),
    ("left drag, wheel", "orbit, nearer and farther"),
    ("right drag", "look around"),
    ("middle drag", "shift the picture (also shift + left drag)"),
    ("W A S D  Q E", "fly; shift: faster"),
    ("space", "play or pause"),
    (",  .", "a frame back or on"),
    ("M", "next motion"),
    ("[  ]", "select a joint"),
    ("arrows, page up/down", "turn it by 5 degrees; shift: by 1"),
    ("backspace", "undo its turns"),
    ("R", "reset the view"),
    ("P", "screenshot (PNG)"),
    ("O", "stage times and splat counts"),
    ("H", "this help"),
    ("Esc", "quit"),
    ("drop a file", "scene, pose or motion"),
)
