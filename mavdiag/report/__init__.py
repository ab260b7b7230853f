"""A flight, a folder of flights or a campaign as one page that needs nothing else: values in, HTML and SVG out.

`flight` and `campaign` draw, `page` writes. matplotlib is imported when the first figure is drawn.
"""
