"""Planning on a Ray cluster: the connection and the executor.

Ray (extra ``ray``) is imported when a cluster is joined, and nowhere else.
"""
