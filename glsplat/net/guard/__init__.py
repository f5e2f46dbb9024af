"""What keeps strangers and greedy clients from the others: who may come in, and how much they may use."""
