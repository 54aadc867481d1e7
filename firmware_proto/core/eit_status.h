/* What every function of the core that can fail returns. OK is 0; a name is never reused. */
#ifndef EIT_STATUS_H
#define EIT_STATUS_H

enum eit_status {
    EIT_OK = 0,
    EIT_AGAIN,       /* not finished: call again later */
    EIT_SPACE,       /* the caller's buffer is too small; nothing was written */
    EIT_DAMAGED,     /* a packet or a stored configuration fails its check */
    EIT_LENGTH,      /* a message has the wrong length for its type */
    EIT_TYPE,        /* a message of a type that this protocol does not have */
    EIT_VERSION,     /* another major version, or another format of configuration */
    EIT_VALUE,       /* a field is outside its range */
    EIT_HARDWARE,    /* made for other electronics */
    EIT_RATE,        /* the front end cannot reach the rate */
    EIT_EMPTY,       /* there is no such stored configuration */
    EIT_STORAGE,     /* the storage did not take a word or an erase */
    EIT_FRONT_END    /* the analogue front end did not answer */
};

#endif
