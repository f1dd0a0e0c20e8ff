"""The viewer: a result in the browser, on viser (extra ``torchjoint[viewer]``)."""
