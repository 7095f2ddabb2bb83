"""The console: a web page for running robots, and the server between both."""
