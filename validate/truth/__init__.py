"""The contact truth suite: phenomena with exact answers, put to every engine."""
