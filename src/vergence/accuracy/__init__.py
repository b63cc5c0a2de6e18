"""How accurate points are, what makes them so, and which head or recording makes them better."""
