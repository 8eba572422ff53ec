"""One file = one method; the file name is the method's name and the file defines `METHOD`."""
