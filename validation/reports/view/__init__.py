"""The page of ``dasim view``: one HTML file to explore a reconstruction or a capture. Read ``page.py`` first.

``parts`` holds its markup, style and scripts, which are put into one file.
"""
