"""Files of motions: written, read back, and judged as their readers follow them."""
