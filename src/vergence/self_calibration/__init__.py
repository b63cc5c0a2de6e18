"""How moving eyes truly stand to each other, from what both of them see, and what persists."""
