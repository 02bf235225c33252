"""The journal's tables. A released schema is never edited: a change is a further entry."""

MIGRATIONS: tuple[tuple[str, ...], ...] = (
    (
        """CREATE TABLE meta (name TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT""",
        """CREATE TABLE pairs (
            i TEXT NOT NULL, j TEXT NOT NULL, revision INTEGER NOT NULL,
            PRIMARY KEY (i, j), CHECK (i < j)
        ) STRICT""",
        # pixels as (u, v); points p as 3 and covariances C as 9 little-endian float64
        """CREATE TABLE correspondences (
            id INTEGER PRIMARY KEY,
            i TEXT NOT NULL, j TEXT NOT NULL,
            operator TEXT NOT NULL,
            revision INTEGER NOT NULL,
            epoch_i TEXT NOT NULL, seq_i INTEGER NOT NULL, u_i REAL NOT NULL, v_i REAL NOT NULL,
            epoch_j TEXT NOT NULL, seq_j INTEGER NOT NULL, u_j REAL NOT NULL, v_j REAL NOT NULL,
            p_i BLOB NOT NULL, C_i BLOB NOT NULL, p_j BLOB NOT NULL, C_j BLOB NOT NULL,
            FOREIGN KEY (i, j) REFERENCES pairs (i, j)
        ) STRICT""",
        """CREATE INDEX correspondences_of_pair ON correspondences (i, j)""",
        """CREATE TABLE sessions (
            operator TEXT NOT NULL, session TEXT NOT NULL, n INTEGER NOT NULL,
            PRIMARY KEY (operator, session)
        ) STRICT""",
        """CREATE TABLE rejections (
            operator TEXT NOT NULL, session TEXT NOT NULL, n INTEGER NOT NULL,
            reason TEXT NOT NULL,
            PRIMARY KEY (operator, session, n),
            FOREIGN KEY (operator, session) REFERENCES sessions (operator, session)
        ) STRICT""",
        # view: encoded protocol.messages.View; header: packed ImageHeader of the JPEG
        """CREATE TABLE views (
            robot TEXT NOT NULL, epoch TEXT NOT NULL, seq INTEGER NOT NULL,
            view BLOB NOT NULL, jpeg BLOB, header BLOB,
            PRIMARY KEY (robot, epoch, seq)
        ) STRICT""",
        # packed protocol.messages.Alignment, the newest accepted one of two views
        """CREATE TABLE alignments (
            robot_i TEXT NOT NULL, epoch_i TEXT NOT NULL, seq_i INTEGER NOT NULL,
            robot_j TEXT NOT NULL, epoch_j TEXT NOT NULL, seq_j INTEGER NOT NULL,
            alignment BLOB NOT NULL,
            PRIMARY KEY (robot_i, epoch_i, seq_i, robot_j, epoch_j, seq_j)
        ) STRICT""",
        """CREATE TABLE poses (robot TEXT PRIMARY KEY, pose BLOB NOT NULL) STRICT""",
    ),  # the fleet's graph has a file of its own, `pose_server.persistence.graph_store`
    ("DROP TABLE alignments", "DROP TABLE poses"),
)
