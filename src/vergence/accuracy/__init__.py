"""How well a head locates points, where its errors come from, and which head meets an accuracy."""
