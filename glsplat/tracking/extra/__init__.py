"""What may be tracked beside head and hands: a waist, feet, a device's own joints of the body."""
