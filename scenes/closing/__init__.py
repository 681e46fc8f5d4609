"""Closing the loop: play, find what the model lacks, add it, play again, keep it or take it back.

One loop (``loop``) serves every kind of scene; a kind brings a ``Subject``: how it plays, what it diagnoses, and what
its cell measures of the error. One rule (``rule``) decides what stays. One result (``result``) tells what came of it.
"""
