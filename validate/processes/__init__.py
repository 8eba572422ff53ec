"""How tasks are run: the campaign, its engines, one supervised process each, and foreign code in isolation."""
