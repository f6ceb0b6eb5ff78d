"""`pcpc host`: a page that shows a run or a log in any browser, and tunes it if it may."""
