"""Where finished tasks lie, under which keys, and what is written across them."""
