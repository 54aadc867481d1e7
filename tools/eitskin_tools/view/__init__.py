"""``eitskin view``: a live page in the browser, from a process that subscribes like any other.

::

    runtime --newest frame--> feed --> board --> server --chunks--> page, page, page
             (<= 30 a second)         (newest of each kind)         (WebGL2 and canvas, each with its history)
"""
