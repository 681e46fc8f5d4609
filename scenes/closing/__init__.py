"""``close-loop``: run, find what the model lacks, add it, run again, keep or reject it.

One loop (``loop``) serves every kind of scene; a kind brings a ``Subject``: how it runs, what it diagnoses, and which
error its cell measures. One rule (``Comparison``) decides what is kept. One result (``result``) reports all trials.
"""
