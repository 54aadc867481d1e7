"""``eitskin view``: a live page in the browser, served by a process of its own that subscribes like anybody else.

::

    runtime --newest frame--> feed --> board --> server --chunks--> page, page, page
             (<= 30 a second)         (newest of each kind)         (WebGL2 and canvas, a history of its own)
"""
