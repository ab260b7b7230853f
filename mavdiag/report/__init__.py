"""A flight, a folder of flights or a campaign as one page that needs nothing else: values in, HTML and SVG out."""
