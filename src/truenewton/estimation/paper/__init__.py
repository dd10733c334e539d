"""The paper (Ricci, Riccardi and Zanotti 2008): read this first.

equations        the unknowns, the systems C, D, E (eqs. 1-4), the imbalance of a reading
svd              section 4: E alpha' = r by singular values; section 5: each cycle alone
identifiability  what the data can and cannot determine
"""
