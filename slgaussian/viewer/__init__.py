"""Look at a scene: live in the browser, asked by word and by click."""
