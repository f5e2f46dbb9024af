"""The analytic body: head and hands to joint rotations, without learned parts."""
