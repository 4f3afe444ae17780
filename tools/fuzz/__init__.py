"""A campaign of wrong, damaged and hostile inputs against the library."""
