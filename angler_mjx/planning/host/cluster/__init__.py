"""Planning on a Ray cluster: how it is joined, what runs there, and what travels there.

Ray (extra ``ray``) is imported when a cluster is joined, and nowhere else.
"""
