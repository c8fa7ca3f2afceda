"""The interactive viewer: what is pressed, what is seen, and what is written over it.

keys, controls, lights    pure: no OpenGL, no window
hud                       texts to pictures
overlays, core            a frame with everything on it, into any framebuffer
window                    a real window and its events
"""
