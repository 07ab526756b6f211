"""The page of a camera for optical engineers; start with ``page``."""
