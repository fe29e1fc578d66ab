"""The label images M_i of the paper (section 3.1): codes looked up by labels."""

import numpy as np


def code_images(labels: np.ndarray, ids: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """What each pixel carries: the code of its object times its weight, and the weight.

    The paper's images have the three numbers alone, and no way to tell a pixel without an object
    from one whose code is (0, 0, 0).

    Parameters
    ----------
    labels : int32 [...]
        Object ids; 0, and what is not among ``ids``, has no object.
    ids : int32 [N]
        Positive and ascending.
    codes : float32 [N, D]

    Returns
    -------
    float32 [..., D + 1]
        The weight is 1, or 0 where there is no object.
    """
    # Ids made elsewhere may be in the millions, too many for a table of all below the largest.
    table = np.zeros((len(ids) + 1, codes.shape[1] + 1), np.float32)
    table[1:, :-1] = codes
    table[1:, -1] = 1
    rows = np.searchsorted(ids, labels)
    known = np.append(ids, 0)[rows] == labels
    return table[np.where(known & (labels > 0), rows + 1, 0)]
