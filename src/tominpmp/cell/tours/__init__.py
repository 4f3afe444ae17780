"""Tours: stations visited in the best order, with the best configurations."""
