"""What a run says: where designs fail, how well they score, where in latent space failures lie, and a report of it.

All is read from the files of a run folder; of the other packages only the vocabulary `mfg.outcome` is known here.
"""
