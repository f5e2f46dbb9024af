"""How far one picture is from another: each measure in one place, on pictures [H, W, 3] in [0, 1]."""
