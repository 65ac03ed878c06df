def confinement(): return ()
