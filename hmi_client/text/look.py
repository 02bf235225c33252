"""How the text client looks: sizes, borders and colours of its panels."""

CSS = """
Screen { background: #10141a; color: #c8d0d8; }
#body { height: 1fr; }
#map, #matrix, #list, .image {
    background: #10141a;
    border: round #33507a;
    border-title-color: #8fb4e0;
    border-subtitle-color: #8a97a6;
}
#map { width: 1fr; min-width: 22; }
#middle { width: 1.3fr; min-width: 26; }
#matrix {
    height: 2fr;
    scrollbar-size: 1 1;
    scrollbar-background: #10141a;
    scrollbar-color: #33507a;
}
#list { height: 1fr; min-height: 5; }
#images { width: 2fr; layout: vertical; }
.image { width: 1fr; height: 1fr; border: round #7a2030; border-title-color: #ff6b6b; }
#map:focus, #matrix:focus, #list:focus { border: heavy #8fb4e0; }
.image:focus { border: heavy #ff3b4e; }
.maximised #map, .maximised #middle { display: none; }
.maximised #images { layout: horizontal; }
#status { height: 3; }
Footer { background: #16202c; }
"""
