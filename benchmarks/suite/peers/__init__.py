"""Other people's ways to the answers of our stages, one file each, written as a good user of that tool would write them.

They are given numbers and files, and share no code with what they are measured against.
"""
