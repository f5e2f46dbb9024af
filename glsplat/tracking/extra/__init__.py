"""What may be tracked beside head and hands: a waist, feet, eyes, a device's own joints of the body."""
